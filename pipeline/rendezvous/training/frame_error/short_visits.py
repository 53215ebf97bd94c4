"""Pairs of robots that had not come far before they met: each map cut to a part of what its robot explored.

How much two maps overlap depends on the ways that robots happened to take. Here each map keeps what lies
within reach of a place of its own, as the robot itself does: overlap is drawn independently of how well the
maps fit.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np

from rendezvous.compiled import njit
from rendezvous.errors import ConfigError
from rendezvous.geometry.occupancy_grid import FREE, UNKNOWN, Cells, Mask, OccupancyGrid, overlap
from rendezvous.geometry.se2 import SE2
from rendezvous.training.frame_error.pairs import MapPair

_WALL_M = 0.15  # walls this close to reached floor are kept
_NEAR_ROBOT_CELLS = 5  # a robot's floor is looked for this far from where it stands


@dataclass(frozen=True, slots=True, kw_only=True)
class ShortVisits:
    """How far the kept parts reach."""

    reach_m: tuple[float, float] = (2.0, 8.0)  # bounds along the floor, drawn log-uniformly for each map

    def __post_init__(self) -> None:
        low, high = self.reach_m
        if not 0.5 <= low <= high <= 1000.0:
            raise ConfigError(
                f"ShortVisits: reach_m is {[low, high]}; must rise from at least 0.5 to at most 1000"
            )


def of_short_visits(pair: MapPair, parameters: ShortVisits, rng: np.random.Generator) -> MapPair:
    """The pair with both maps cut. A map whose robot does not stand on its floor stays whole."""
    robots = (pair.T_m0_r0 or pair.T_m0_r1, pair.T_m1_r1)
    low, high = np.log(parameters.reach_m)
    grids = [
        explored_part(grid, T_m_r, reach_m=float(np.exp(rng.uniform(low, high))), rng=rng)
        for grid, T_m_r in zip((pair.grid_0, pair.grid_1), robots, strict=True)
    ]
    return replace(pair, grid_0=grids[0], grid_1=grids[1], overlap=overlap(grids[0], grids[1], pair.T_m0_m1))


def explored_part(
    grid: OccupancyGrid, T_m_r: SE2, *, reach_m: float, rng: np.random.Generator
) -> OccupancyGrid:
    """What lies within reach, along the floor, of a place drawn uniformly within nine tenths of it from the
    robot."""
    floor = grid.cells == FREE
    start = _floor_near(floor, grid, T_m_r)
    if start is None:
        return grid
    cells = reach_m / grid.resolution_m
    place = rng.choice(np.flatnonzero(_reached(floor, start, 0.9 * cells)))
    reached = _reached(floor, int(place), cells).astype(np.uint8)
    wide = 2 * round(_WALL_M / grid.resolution_m) + 1
    kept = cv2.dilate(reached, np.ones((wide, wide), np.uint8)) > 0
    return replace(grid, cells=np.where(kept, grid.cells, np.uint8(UNKNOWN)))


def _floor_near(floor: Mask, grid: OccupancyGrid, T_m_r: SE2) -> int | None:
    """The flat index of the floor cell nearest to a robot, if one is near."""
    T_g_r = grid.T_m_g.inverse() @ T_m_r
    rows, cols = np.nonzero(floor)
    away = np.hypot(rows + 0.5 - T_g_r.y_m / grid.resolution_m, cols + 0.5 - T_g_r.x_m / grid.resolution_m)
    if not away.size or away.min() > _NEAR_ROBOT_CELLS:
        return None
    nearest = int(away.argmin())
    return int(rows[nearest] * floor.shape[1] + cols[nearest])


def _reached(floor: Mask, start: int, cells: float) -> Mask:
    return _flooded(floor, start, cells).astype(np.bool_)


@njit
def _flooded(floor: Mask, start: int, limit: float) -> Cells:
    """(H, W) 1 where floor lies within so many cells of the start, going straight or diagonally by turns.

    Turns of four and of eight neighbours reach an octagon, an eighth wider than the circle at most.
    """
    height, width = floor.shape
    out = np.zeros((height, width), np.uint8)
    queue = np.empty(height * width, np.int64)
    queue[0], end, first, step = start, 1, 0, 0
    out[start // width, start % width] = 1
    while first < end and step < limit:
        last = end
        for i in range(first, last):
            row, col = queue[i] // width, queue[i] % width
            for down in range(-1, 2):
                for right in range(-1, 2):
                    if step % 2 == 0 and down != 0 and right != 0:
                        continue
                    y, x = row + down, col + right
                    if 0 <= y < height and 0 <= x < width and floor[y, x] and out[y, x] == 0:
                        out[y, x] = 1
                        queue[end] = y * width + x
                        end += 1
        first, step = last, step + 1
    return out
