"""Pose graphs as g2o files, which g2o, GTSAM, Ceres and SLAM Toolbox's users read."""

from __future__ import annotations

import numpy as np

from rendezvous.geometry.se2 import Array
from rendezvous.slam.pose_graph import PoseGraph

_UPPER = np.triu_indices(3)


def g2o_bytes(poses: Array, graph: PoseGraph) -> bytes:
    """Poses (N, 3) as `VERTEX_SE2 id x y yaw`, the first fixed, and motions as `EDGE_SE2`.

    An edge is `a b x y yaw` and the upper triangle of its information, row by row.
    """
    lines = [f"VERTEX_SE2 {i} {x:.9g} {y:.9g} {yaw:.9g}" for i, (x, y, yaw) in enumerate(poses.tolist())]
    lines.append("FIX 0")
    for (a, b), motion, information in zip(graph.ends, graph.motions, graph.information, strict=True):
        numbers = " ".join(f"{value:.9g}" for value in (*motion, *information[_UPPER]))
        lines.append(f"EDGE_SE2 {a} {b} {numbers}")
    return ("\n".join(lines) + "\n").encode()
