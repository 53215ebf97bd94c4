"""This project's SLAM over recorded scans, with loops closed."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from rendezvous.geometry.se2 import Array
from rendezvous.loop_closure.closing import close_loops
from rendezvous.loop_closure.matching import LoopMatcher, LoopWindow
from rendezvous.loop_closure.scan_graph import ScanGraph, all_poses, scan_graph
from rendezvous.loop_closure.submaps import SubmapTracker
from rendezvous.recorded.laser_log import LaserLog
from rendezvous.recorded.mapped import LidarModel, LogScans, Mapped
from rendezvous.slam.mapping import OccupancyMapper
from rendezvous.slam.pose_graph import PoseGraph
from rendezvous.slam.slam import SlamParameters, compose, relative

SUBMAP_M = 8.0  # path after which the next submap begins; each holds twice as much


@dataclass(frozen=True, slots=True, kw_only=True)
class LoopCounts:
    """What the search for loops came to."""

    submaps: int
    compared: int  # pairs of submaps
    closed: int  # loops that are believed
    rejected: int  # loops that contradict the rest


@dataclass(frozen=True, slots=True, kw_only=True)
class ClosedMap:
    """A log after SLAM with loop closure."""

    mapped: Mapped
    counts: LoopCounts
    # vertices: (N + M, 3) poses of the robot in its map at all N scans, then of the M submaps' frames; graph:
    # what was measured between them.
    vertices: Array
    graph: PoseGraph


def map_with_loops(
    log: LaserLog,
    order: NDArray[np.int64],
    odometry: Array,
    *,
    lidar: LidarModel,
    parameters: SlamParameters,
    window: LoopWindow,
) -> ClosedMap:
    """Run SLAM over some scans of a log, close loops, and draw the map from the path that follows.

    Args:
        log, order, odometry, lidar, parameters: as for `recorded.mapped.map_scans`.
        window: compares submaps.
    """
    scans = LogScans(log, order, odometry, lidar=lidar, parameters=parameters)
    tracker = SubmapTracker(scans.parameters, length_m=SUBMAP_M)
    for i in range(len(scans)):
        tracker.add(scans.scan(i), scans.odometry(i))
    path = tracker.path()
    closed = close_loops(path, LoopMatcher(scans, path.submaps, window))
    settled = scan_graph(scans, path, closed.frames, closed.loops)
    # The map frame is where the first sweep began; the path starts where it ended.
    first = scans.sweep(0).odometry
    began = relative(first[0], first[-1])
    poses = np.array([compose(began, pose) for pose in all_poses(path, settled)])
    mapped = _drawn(scans, poses)
    frames = [scans.of_robot(compose(began, frame)) for frame in settled.poses[: settled.submaps]]
    return ClosedMap(
        mapped=mapped,
        counts=LoopCounts(
            submaps=len(path.submaps),
            compared=closed.compared,
            closed=len(closed.loops),
            rejected=closed.rejected,
        ),
        vertices=np.concatenate([mapped.poses, frames]),
        graph=_of_robot(scans, settled),
    )


def _of_robot(scans: LogScans, settled: ScanGraph) -> PoseGraph:
    """The graph in the robot's frame; scans have their own numbers, submaps follow."""
    graph = settled.graph
    numbers = np.concatenate([len(scans) + np.arange(settled.submaps), settled.numbers])
    x, y, _ = scans.T_r_s
    # A small motion at the lidar, as the robot sees it.
    back = np.array([[1.0, 0.0, -y], [0.0, 1.0, x], [0.0, 0.0, 1.0]])
    return replace(
        graph,
        ends=numbers[graph.ends],
        motions=np.array([scans.of_robot(motion) for motion in graph.motions]),
        information=back.T @ graph.information @ back,
    )


def _drawn(scans: LogScans, poses: Array) -> Mapped:
    """The map of scans at these poses of the frame s."""
    mapping = scans.parameters.mapping
    mapper = OccupancyMapper(extent_m=scans.extent_m(poses, mapping.resolution_m), parameters=mapping)
    for i, pose in enumerate(poses):
        scan = scans.scan(i)
        mapper.integrate(scan.points_m, scan.origins_m, scan.hits, scan.clears, pose)
    return Mapped(
        grid=scans.map_of_robot(mapper.grid()), poses=np.array([scans.of_robot(pose) for pose in poses])
    )
