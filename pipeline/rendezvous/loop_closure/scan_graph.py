"""The last step: every scan is tied to the submaps around it, and all poses are fitted at once.

The submaps' graph closes loops; within a submap the walls are as the first pass saw them. Here each scan is
registered to its own submaps and to others that show the same walls, and submaps are drawn anew from the
poses that follow (a graph of scans and submaps, as in Konolige et al., "Efficient sparse pose adjustment for
2D mapping", IROS 2010).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rendezvous.geometry.se2 import SE2, Array
from rendezvous.loop_closure.matching import Loop
from rendezvous.loop_closure.submaps import REACH_M, SubmapPath, honest
from rendezvous.recorded.mapped import LogScans
from rendezvous.slam.pose_graph import PoseGraph, leniently_fitted
from rendezvous.slam.scan_match import registered
from rendezvous.slam.slam import LidarScan, compose, relative
from rendezvous.slam.surface_map import Surface, SurfaceMap

_ROUNDS = 2
_STEP_M, _STEP_RAD = 0.2, 0.2  # scans closer than this to the last one of the graph follow it
_NEAR_M = 6.0  # from a scan to the middle of a submap that it may be tied to
_MOST_OTHERS = 5  # submaps that a scan is tied to besides its own
_GATE_OWN_M, _GATE_M = 0.15, 0.2
_SIGMA_M, _SIGMA_RAD = 0.1, math.radians(2.0)  # of poses before this step
_MOST_M, _MOST_RAD = 0.3, math.radians(5.0)  # a registration that moves a scan farther is a wrong one
_LEAST_POINTS, _LEAST_SHARE = 20, 0.5  # of a scan's points that must lie on the other submap's walls
_BENT_M, _BENT_RAD = 0.02, math.radians(0.3)  # sigma of what a submap is bent by
# Odometry's sigmas besides those of scan matching: wheels also slip where the robot turns on the spot.
_SLIP_M, _SLIP_M_PER_RAD, _SLIP_RAD_PER_M = 0.02, 0.1, 0.03


@dataclass(frozen=True, slots=True, kw_only=True)
class ScanGraph:
    """The graph of the last round, and its solution."""

    graph: PoseGraph  # poses: submaps, then the scans that are in it
    poses: Array  # (M + K, 3)
    numbers: NDArray[np.int64]  # (K,) of these scans

    @property
    def submaps(self) -> int:
        """How many of the poses are submaps' frames."""
        return len(self.poses) - len(self.numbers)


def scan_graph(scans: LogScans, path: SubmapPath, frames: Array, loops: list[Loop]) -> ScanGraph:
    """Fit all poses, from where the submaps' frames (M, 3) put them and with the loops that are believed."""
    return _Scans(scans, path, frames, loops).settled()


def all_poses(path: SubmapPath, settled: ScanGraph) -> Array:
    """(N, 3) poses of all scans; those that are not in the graph follow the last one that is."""
    before = path.poses(path.frames())
    after = settled.poses[settled.submaps :]
    at = np.searchsorted(settled.numbers, np.arange(len(before)), side="right") - 1
    return np.array(
        [
            compose(after[k], relative(before[settled.numbers[k]], pose))
            for k, pose in zip(at, before, strict=True)
        ]
    )


class _Scans:
    """The scans of the graph."""

    def __init__(self, scans: LogScans, path: SubmapPath, frames: Array, loops: list[Loop]) -> None:
        self._path, self._loops, self._parameters = path, loops, scans.parameters
        first = path.poses(frames)
        self._numbers = _apart(first)
        self._poses = first[self._numbers]
        self._frames = frames
        self._scans = [_with_normals(scans.scan(int(i))) for i in self._numbers]
        self._odometry = np.array([scans.odometry(int(i)) for i in self._numbers])
        self._surfaces: list[Surface] = [submap.surface for submap in path.submaps]
        at = {int(number): k for k, number in enumerate(self._numbers)}
        # members: (scan of the graph, its pose) of each submap; own: the submaps of each scan.
        self._members = [
            [(at[int(n)], pose) for n, pose in zip(submap.scans, submap.poses, strict=True) if int(n) in at]
            for submap in path.submaps
        ]
        self._own: list[dict[int, Array]] = [{} for _ in self._numbers]
        for k, members in enumerate(self._members):
            for i, pose in members:
                self._own[i][k] = pose

    def settled(self) -> ScanGraph:
        """Tie and fit, draw the submaps anew, and so on."""
        for number in range(_ROUNDS):
            if number:
                self._draw()
            graph = self._graph()
            fit = leniently_fitted(np.concatenate([self._frames, self._poses]), graph)
            self._frames, self._poses = np.split(fit.poses, [len(self._frames)])
        return ScanGraph(graph=graph, poses=fit.poses, numbers=self._numbers)

    def _draw(self) -> None:
        """Draw the submaps from the poses as they are now."""
        p = self._parameters.match
        for k, members in enumerate(self._members):
            moved = [(i, relative(self._frames[k], self._poses[i])) for i, _ in members]
            reach_m = max((math.hypot(*pose[:2]) for _, pose in moved), default=0.0)
            surface = SurfaceMap(
                extent_m=2.0 * (REACH_M + reach_m + 1.0), cell_m=p.cell_m, same_side=p.same_side,
                max_weight=p.max_weight,
            )  # fmt: skip
            for i, pose in moved:
                self._own[i][k] = pose
                scan = self._scans[i]
                surface.insert(scan.points_m, scan.normals, scan.sigma_m, pose)
            self._surfaces[k] = surface.cropped()

    def _graph(self) -> PoseGraph:
        """Ties of scans to submaps, odometry between scans, and the loops; only own submaps are sure."""
        ties, sure = self._ties()
        motions = np.array([tie[2] for tie in ties])
        bent = _BENT_M, _BENT_RAD
        count, following = len(self._frames), range(len(self._scans) - 1)
        driven = [self._driven(i) for i in following]
        edges = [
            *((k, count + i) for k, i, *_ in ties),
            *((count + i, count + i + 1) for i in following),
            *((loop.a, loop.b) for loop in self._loops),
        ]
        return PoseGraph(
            ends=np.array(edges),
            motions=np.array([*motions, *(m for m, _ in driven), *(loop.T_a_b for loop in self._loops)]),
            information=np.array(
                [
                    *honest(np.array([tie[3] for tie in ties]), motions, bent=bent),
                    *(information for _, information in driven),
                    *(loop.information for loop in self._loops),
                ]
            ),
            claimed=np.arange(len(edges)) >= sure,
        )

    def _ties(self) -> tuple[list[tuple[int, int, Array, Array]], int]:
        """Submap, scan, its pose in it and what `registered` says of that; first come all own submaps'."""
        edges: list[tuple[int, int, Array, Array]] = []
        centres = np.array(
            [SE2.from_array(f) @ m.centre() for f, m in zip(self._frames, self._path.submaps, strict=True)]
        )
        for i in range(len(self._scans)):
            for k, before in self._own[i].items():
                edges.append((k, i, *self._tied(i, k, before, _GATE_OWN_M)[:2]))
        sure = len(edges)
        for i in range(len(self._scans)):
            for k in self._others(i, centres):
                before = relative(self._frames[k], self._poses[i])
                pose, information, matched = self._tied(i, k, before, _GATE_M)
                moved = relative(before, pose)
                if (
                    matched >= max(_LEAST_POINTS, _LEAST_SHARE * len(self._scans[i].points_m))
                    and math.hypot(moved[0], moved[1]) <= _MOST_M
                    and abs(moved[2]) <= _MOST_RAD
                ):
                    edges.append((k, i, pose, information))
        return edges, sure

    def _others(self, i: int, centres: Array) -> list[int]:
        """Submaps around a scan that it is no part of; no two that follow each other, as these overlap."""
        away_m = np.hypot(*(centres - self._poses[i, :2]).T)
        taken, found = list(self._own[i]), list[int]()
        for k in np.argsort(away_m, kind="stable").tolist():
            if away_m[k] > _NEAR_M or len(found) == _MOST_OTHERS:
                break
            if all(abs(k - other) > 1 for other in taken):
                taken.append(k)
                found.append(k)
        return found

    def _tied(self, i: int, k: int, before: Array, gate_m: float) -> tuple[Array, Array, int]:
        """As `registered` to a submap."""
        scan = self._scans[i]
        return registered(
            self._surfaces[k], scan.points_m, scan.normals, scan.sigma_m, before,
            sigma_xy_m=_SIGMA_M, sigma_yaw_rad=_SIGMA_RAD, gate_m=gate_m, iterations=15,
        )  # fmt: skip

    def _driven(self, i: int) -> tuple[Array, Array]:
        """Odometry's motion to the next scan, and its information."""
        motion = relative(self._odometry[i], self._odometry[i + 1])
        sigma_m, sigma_rad = self._parameters.match.prior_sigmas(motion)
        sigma_m += _SLIP_M + _SLIP_M_PER_RAD * abs(float(motion[2]))
        sigma_rad += _SLIP_RAD_PER_M * math.hypot(motion[0], motion[1])
        return motion, np.diag([sigma_m**-2, sigma_m**-2, sigma_rad**-2])


def _apart(poses: Array) -> NDArray[np.int64]:
    """Numbers of the scans that are a step from the one before; the first is."""
    numbers = [0]
    for i in range(1, len(poses)):
        moved = relative(poses[numbers[-1]], poses[i])
        if math.hypot(moved[0], moved[1]) > _STEP_M or abs(moved[2]) > _STEP_RAD:
            numbers.append(i)
    return np.array(numbers)


def _with_normals(scan: LidarScan) -> LidarScan:
    """The points that can be matched."""
    kept = (np.abs(scan.normals).sum(axis=1) > 0.0) & (
        np.hypot(*(scan.points_m - scan.origins_m).T) < REACH_M
    )
    return LidarScan(*(values[kept] for values in scan))
