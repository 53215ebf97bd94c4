"""Occupancy mapping: log-odds, beam by beam (Moravec & Elfes, 1985)."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rendezvous.compiled import njit
from rendezvous.errors import require_within
from rendezvous.geometry.occupancy_grid import FREE, OCCUPIED, UNKNOWN, OccupancyGrid
from rendezvous.geometry.se2 import SE2, Array


@dataclass(frozen=True, slots=True, kw_only=True)
class MappingParameters:
    """How the occupancy grid is updated and read."""

    resolution_m: float = 0.05  # side of a cell
    # hit, miss: log-odds that a beam adds to the cell it ends in and to those it crosses.
    hit: float = 0.9
    miss: float = -0.4
    limit: float = 4.0  # log-odds stay within ± this, so that a robot that drove away is forgotten
    # occupied, free: a cell is occupied above the first and free below the second log-odds.
    occupied: float = 0.62
    free: float = -0.62
    # How many neighbouring beams without echo clear the map (open space; a single one is a lost echo).
    no_echo_run: int = 5

    def __post_init__(self) -> None:
        require_within(
            self, resolution_m=(0.01, 0.5), hit=(0.01, 10), miss=(-10, -0.01), limit=(0.1, 50),
            occupied=(0, self.limit), free=(-self.limit, 0), no_echo_run=(1, 10_000),
        )  # fmt: skip


@njit
def _trace(
    x0: float,
    y0: float,
    x1: float,
    y1: float,
    log_odds: NDArray[np.float32],
    stamps: NDArray[np.int32],
    stamp: int,
    miss: float,
    limit: float,
) -> None:
    """Add a miss to the cells from (x0, y0) to (x1, y1) [cells], once per scan and never to a hit cell."""
    col, row = math.floor(x0), math.floor(y0)
    dx, dy = x1 - x0, y1 - y0
    step_c = 1 if dx > 0.0 else -1
    step_r = 1 if dy > 0.0 else -1
    delta_c = 1.0 / abs(dx) if dx != 0.0 else np.inf
    delta_r = 1.0 / abs(dy) if dy != 0.0 else np.inf
    next_c = (col + (step_c > 0) - x0) / dx if dx != 0.0 else np.inf
    next_r = (row + (step_r > 0) - y0) / dy if dy != 0.0 else np.inf
    height, width = log_odds.shape
    while 0 <= row < height and 0 <= col < width:
        if stamps[row, col] != stamp:
            stamps[row, col] = stamp
            log_odds[row, col] = max(log_odds[row, col] + miss, -limit)
        if next_c < next_r:
            if next_c > 1.0:
                return
            col += step_c
            next_c += delta_c
        else:
            if next_r > 1.0:
                return
            row += step_r
            next_r += delta_r


@njit
def _integrate(
    points_m: Array,
    origins_m: Array,
    hits: NDArray[np.bool_],
    clears: NDArray[np.bool_],
    pose: Array,
    log_odds: NDArray[np.float32],
    stamps: NDArray[np.int32],
    stamp: int,
    resolution_m: float,
    hit: float,
    miss: float,
    limit: float,
    box: NDArray[np.int64],
) -> None:
    """Hits first, so that a grazing beam of the same scan cannot clear them; then misses."""
    c, s = math.cos(pose[2]), math.sin(pose[2])
    height, width = log_odds.shape
    n = points_m.shape[0]
    ends = np.empty((n, 4))
    for i in range(n):
        ends[i, 0] = (pose[0] + c * origins_m[i, 0] - s * origins_m[i, 1]) / resolution_m + 0.5 * width
        ends[i, 1] = (pose[1] + s * origins_m[i, 0] + c * origins_m[i, 1]) / resolution_m + 0.5 * height
        ends[i, 2] = (pose[0] + c * points_m[i, 0] - s * points_m[i, 1]) / resolution_m + 0.5 * width
        ends[i, 3] = (pose[1] + s * points_m[i, 0] + c * points_m[i, 1]) / resolution_m + 0.5 * height
        if hits[i] or clears[i]:
            row, col = math.floor(ends[i, 3]), math.floor(ends[i, 2])
            box[0], box[1] = min(box[0], row), min(box[1], col)
            box[2], box[3] = max(box[2], row + 1), max(box[3], col + 1)
        if hits[i] and 0 <= row < height and 0 <= col < width and stamps[row, col] != stamp:
            stamps[row, col] = stamp
            log_odds[row, col] = min(log_odds[row, col] + hit, limit)
    for i in range(n):
        if hits[i] or clears[i]:
            _trace(ends[i, 0], ends[i, 1], ends[i, 2], ends[i, 3], log_odds, stamps, stamp, miss, limit)


class OccupancyMapper:
    """The log-odds grid of one robot, the map frame's origin at its centre.

    It holds a square of side `extent_m`; what lies outside is not mapped.
    """

    def __init__(self, *, extent_m: float, parameters: MappingParameters) -> None:
        cells = 2 * math.ceil(0.5 * extent_m / parameters.resolution_m)
        self.parameters = parameters
        self._log_odds = np.zeros((cells, cells), np.float32)
        self._stamps = np.zeros((cells, cells), np.int32)
        self._scans = 0
        self._box = np.array([cells // 2, cells // 2, cells // 2 + 1, cells // 2 + 1])

    def integrate(
        self,
        points_m: Array,
        origins_m: Array,
        hits: NDArray[np.bool_],
        clears: NDArray[np.bool_],
        pose: Array,
    ) -> None:
        """Add one scan.

        Beams run from their origins to points (B, 2) in the robot frame, which `hits` say end on a surface
        and `clears` in open space.
        """
        p = self.parameters
        self._scans += 1
        _integrate(
            points_m, origins_m, hits, clears, pose, self._log_odds, self._stamps, self._scans,
            p.resolution_m, p.hit, p.miss, p.limit, self._box,
        )  # fmt: skip

    def window(self) -> tuple[NDArray[np.float32], SE2]:
        """The part touched so far: (H, W) log-odds, not to be written to, and the pose of its corner."""
        height, width = self._log_odds.shape
        r0, c0 = max(int(self._box[0]), 0), max(int(self._box[1]), 0)
        r1, c1 = min(int(self._box[2]), height), min(int(self._box[3]), width)
        resolution_m = self.parameters.resolution_m
        corner = SE2((c0 - 0.5 * width) * resolution_m, (r0 - 0.5 * height) * resolution_m, 0.0)
        return self._log_odds[r0:r1, c0:c1], corner

    def known_area_m2(self) -> float:
        """Area of the occupied and free cells."""
        log_odds, _ = self.window()
        p = self.parameters
        known = np.count_nonzero((log_odds > p.occupied) | (log_odds < p.free))
        return float(known) * p.resolution_m**2

    def grid(self) -> OccupancyGrid:
        """The trinary map, cropped to its known part."""
        log_odds, T_m_g = self.window()
        cells = np.full(log_odds.shape, UNKNOWN, np.uint8)
        cells[log_odds > self.parameters.occupied] = OCCUPIED
        cells[log_odds < self.parameters.free] = FREE
        return OccupancyGrid(cells=cells, resolution_m=self.parameters.resolution_m, T_m_g=T_m_g).cropped()
