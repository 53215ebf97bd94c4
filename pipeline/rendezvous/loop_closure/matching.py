"""Whether two submaps show one place, and how they lie to each other.

An estimator of the frame error searches a window on both, as at a rendezvous of two robots. Then the walls of
one are registered to the other's, and both must agree wherever both are known.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from rendezvous.alignment.estimate import FrameErrorEstimator
from rendezvous.alignment.window import SearchRange, map_window
from rendezvous.fusion.verdict import MOST_CONFLICTS, map_agreement
from rendezvous.geometry.occupancy_grid import OccupancyGrid
from rendezvous.geometry.se2 import SE2, Array
from rendezvous.loop_closure.submaps import REACH_M, Submap, honest
from rendezvous.recorded.mapped import LogScans
from rendezvous.slam.mapping import OccupancyMapper
from rendezvous.slam.scan_match import registered
from rendezvous.slam.surface_map import NX, WEIGHT, X

SIGMAS = 3.0  # standard deviations that a search reaches, within these limits
NARROWEST = SearchRange(xy_m=0.5, yaw_rad=math.radians(5.0))
WIDEST = SearchRange(xy_m=4.0, yaw_rad=math.radians(45.0))
WINDOW_M = 19.2  # side of the window
_TURN_RAD = math.radians(22.5)  # of the window against the cells of submaps, which then err each its own way
_TOLERANCE_M = 0.15  # walls this close to each other agree
_LEAST_WALL_SHARE = 0.6
_LEAST_COMPARED_M2 = 0.6  # area of the walls in both maps that must have been compared
_BENT_M, _BENT_RAD = 0.03, math.radians(0.3)  # sigma of what a submap is bent by
_GATES_M = (0.3, 0.15)  # of the registration, one after the other
_SURE_M, _SURE_RAD = (0.02, 0.2), (math.radians(0.3), math.radians(3.0))  # limits of a search's sigmas

Searching = Callable[[SearchRange], FrameErrorEstimator]
"""Makes the estimator for a range."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LoopWindow:
    """What compares submaps, and the side of the cells that it takes."""

    searching: Searching
    cell_m: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Loop:
    """A place that two submaps show."""

    a: int  # the earlier submap
    b: int
    T_a_b: Array  # (3,) submap b's frame in that of a
    information: Array  # (3, 3) of T_a_b, in the axes of b


class LoopMatcher:
    """Compares submaps of one log."""

    def __init__(self, scans: LogScans, submaps: list[Submap], window: LoopWindow) -> None:
        self._scans, self._submaps = scans, submaps
        self._searching, self._cell_m = window.searching, window.cell_m
        self._grids: dict[int, OccupancyGrid] = {}

    def __call__(self, a: int, b: int, T_a_b: Array, covariance: Array) -> Loop | None:
        """Compare two submaps, b being about at T_a_b (3,) with a covariance (3, 3) in the axes of b."""
        found = self._searched(a, b, SE2.from_array(T_a_b), covariance)
        if found is None:
            return None
        loop = self._registered(a, b, *found)
        return loop if self._agree(loop) else None

    def _agree(self, loop: Loop) -> bool:
        """Whether there are walls in both submaps, on each other, and none where the other saw floor."""
        found = map_agreement(
            self._grid(loop.a), self._grid(loop.b), SE2.from_array(loop.T_a_b), coincide_m=_TOLERANCE_M
        )
        return (
            found.compared_m * self._cell_m >= _LEAST_COMPARED_M2
            and found.wall_share is not None
            and found.wall_share >= _LEAST_WALL_SHARE
            and found.conflict_share is not None
            and found.conflict_share <= MOST_CONFLICTS
        )

    def _searched(self, a: int, b: int, T_a_b: SE2, covariance: Array) -> tuple[SE2, float, float] | None:
        """Where the search finds b, and its sigmas [m, rad]; None for nowhere, or for more than one place."""
        middle = 0.5 * (self._submaps[a].centre() + T_a_b @ self._submaps[b].centre())
        T_a_v = SE2(float(middle[0]), float(middle[1]), _TURN_RAD)
        window = map_window(
            self._grid(a), self._grid(b), T_a_b, T_a_v, cells=round(WINDOW_M / self._cell_m),
            cell_m=self._cell_m,
        )  # fmt: skip
        estimate = self._searching(_range(covariance))(window)
        if estimate.theta is None or estimate.covariance is None or estimate.ambiguous:
            return None
        T = T_a_v @ estimate.theta.inverse() @ T_a_v.inverse() @ T_a_b
        sigma_rad = float(np.clip(math.sqrt(estimate.covariance[2, 2]), *_SURE_RAD))
        # The covariance is that of the window's middle: b's frame also moves as b turns about it.
        arm_m = math.dist((T.x_m, T.y_m), middle)
        sigma_m = math.sqrt(float(np.linalg.eigvalsh(estimate.covariance[:2, :2]).max()))
        return T, float(np.clip(math.hypot(sigma_m, arm_m * sigma_rad), *_SURE_M)), sigma_rad

    def _registered(self, a: int, b: int, T_a_b: SE2, sigma_m: float, sigma_rad: float) -> Loop:
        """Register b's walls to those of a; what the search found is the prior."""
        elements = self._submaps[b].surface.elements
        pose, information = T_a_b.as_array(), np.eye(3)
        for gate_m in _GATES_M:
            pose, information, _ = registered(
                self._submaps[a].surface, np.ascontiguousarray(elements[:, X : X + 2]),
                np.ascontiguousarray(elements[:, NX : NX + 2]), 0.01 / np.sqrt(elements[:, WEIGHT]), pose,
                sigma_xy_m=sigma_m, sigma_yaw_rad=sigma_rad, gate_m=gate_m, iterations=15,
            )  # fmt: skip
        return Loop(a=a, b=b, T_a_b=pose, information=honest(information, pose, bent=(_BENT_M, _BENT_RAD)))

    def _grid(self, number: int) -> OccupancyGrid:
        """A submap's occupancy grid, drawn when it is first asked for."""
        if number not in self._grids:
            self._grids[number] = _drawn(self._scans, self._submaps[number], self._cell_m)
        return self._grids[number]


def _range(covariance: Array) -> SearchRange:
    """How far to search."""
    xy_m = SIGMAS * math.sqrt(float(np.linalg.eigvalsh(covariance[:2, :2]).max()))
    yaw_rad = SIGMAS * math.sqrt(covariance[2, 2])
    return SearchRange(
        xy_m=min(max(xy_m, NARROWEST.xy_m), WIDEST.xy_m),
        yaw_rad=min(max(yaw_rad, NARROWEST.yaw_rad), WIDEST.yaw_rad),
    )


def _drawn(scans: LogScans, submap: Submap, cell_m: float) -> OccupancyGrid:
    reach_m = REACH_M + float(np.abs(submap.poses[:, :2]).max()) + 1.0
    mapper = OccupancyMapper(
        extent_m=2.0 * reach_m, parameters=replace(scans.parameters.mapping, resolution_m=cell_m)
    )
    for number, pose in zip(submap.scans, submap.poses, strict=True):
        scan = scans.scan(int(number))
        near = scan.hits & (np.hypot(*(scan.points_m - scan.origins_m).T) < REACH_M)
        mapper.integrate(scan.points_m, scan.origins_m, near, scan.clears, pose)
    return mapper.grid()
