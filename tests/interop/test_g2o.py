"""Pose graphs as g2o files."""

import numpy as np

from rendezvous.interop.g2o import g2o_bytes
from rendezvous.slam.pose_graph import PoseGraph


def test_vertices_and_edges_are_those_of_the_graph():
    poses = np.array([[0.0, 0.0, 0.0], [1.5, -2.0, 0.25]])
    information = np.array([[4.0, 1.0, 2.0], [1.0, 5.0, 3.0], [2.0, 3.0, 6.0]])
    graph = PoseGraph(
        ends=np.array([[0, 1]]),
        motions=np.array([[1.4, -2.1, 0.3]]),
        information=information[None],
        claimed=np.zeros(1, np.bool_),
    )
    assert g2o_bytes(poses, graph).decode().splitlines() == [
        "VERTEX_SE2 0 0 0 0",
        "VERTEX_SE2 1 1.5 -2 0.25",
        "FIX 0",
        "EDGE_SE2 0 1 1.4 -2.1 0.3 4 1 2 5 3 6",
    ]
