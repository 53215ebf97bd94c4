"""Obstacles that stand about: boxes, round ones and the legs of tables, drawn into maps by their outlines."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import compress
from typing import NamedTuple

import cv2
import numpy as np

from rendezvous.geometry.occupancy_grid import FREE, OCCUPIED, UNKNOWN, OccupancyGrid
from rendezvous.geometry.se2 import SE2, Array
from rendezvous.training.frame_error.pairs import MapPair

_IN_BOTH = 0.7
"""Share of obstacles that stand in both maps; the others were moved between the two visits."""

_ROBOT_RADIUS_M = 0.15
_SUBPIXEL_BITS = 4


class Obstacle(NamedTuple):
    """Closed outlines in m0, each (N, 2) [m]; a table has four, its legs."""

    outlines_m: tuple[Array, ...]


@dataclass(frozen=True, slots=True)
class Obstacles:
    """Obstacles, and which maps show them: (N, 2) bool."""

    obstacles: tuple[Obstacle, ...]
    shown: np.ndarray[tuple[int, int], np.dtype[np.bool_]]

    def seen_by(self, robot: int) -> tuple[Obstacle, ...]:
        """The obstacles that one robot's map shows."""
        return tuple(compress(self.obstacles, self.shown[:, robot]))


def draw_obstacles(pair: MapPair, *, count: int, rng: np.random.Generator) -> Obstacles:
    """At most `count` obstacles at free cells of either map, uniform; a third each boxes, round ones,
    tables.

    None stands on a robot or between the two, which see each other.
    """
    places_m0 = [
        T_m0_m @ p_m
        for grid, T_m0_m in ((pair.grid_0, SE2.identity()), (pair.grid_1, pair.T_m0_m1))
        for p_m in _free_places(grid, count, rng)
    ]
    which = rng.integers(0, len(places_m0), count) if places_m0 else ()
    drawn = [_obstacle(places_m0[int(i)], rng) for i in which]
    obstacles = [obstacle for obstacle in drawn if not _in_the_way(obstacle, pair)]
    shown = np.ones((len(obstacles), 2), np.bool_)
    moved = np.flatnonzero(rng.random(len(obstacles)) >= _IN_BOTH)
    shown[moved, rng.integers(0, 2, len(moved))] = False
    return Obstacles(obstacles=tuple(obstacles), shown=shown)


def _in_the_way(obstacle: Obstacle, pair: MapPair) -> bool:
    """Whether an obstacle is closer to the line of sight than a robot's radius."""
    seen_m = np.array([pair.T_m0_r1.x_m, pair.T_m0_r1.y_m])
    T_m0_r0 = pair.T_m0_r0 or pair.T_m0_r1
    along_m = seen_m - (T_m0_r0.x_m, T_m0_r0.y_m)
    outline_m = np.concatenate(obstacle.outlines_m)
    centre_m = outline_m.mean(axis=0)
    radius_m = float(np.hypot(*(outline_m - centre_m).T).max())
    share = np.clip((seen_m - centre_m) @ along_m / max(float(along_m @ along_m), 1e-9), 0.0, 1.0)
    away_m = float(np.hypot(*(seen_m - share * along_m - centre_m)))
    return away_m < radius_m + _ROBOT_RADIUS_M


def _free_places(grid: OccupancyGrid, count: int, rng: np.random.Generator) -> Array:
    """(count or 0, 2) [m] centres of free cells."""
    free = np.flatnonzero(grid.cells.ravel() == FREE)
    if not len(free):
        return np.empty((0, 2))
    row, col = np.divmod(free[rng.integers(0, len(free), count)], grid.cells.shape[1])
    return grid.T_m_g @ (grid.resolution_m * (np.stack([col, row], axis=1) + 0.5))


def _obstacle(p_m0: Array, rng: np.random.Generator) -> Obstacle:
    T_m0_obstacle = SE2(float(p_m0[0]), float(p_m0[1]), float(rng.uniform(-np.pi, np.pi)))
    kind = rng.integers(3)
    if kind == 0:  # a chest, a shelf, a bed: 0.2 to 1.6 m by 0.2 to 0.8 m
        return Obstacle((T_m0_obstacle @ _box(rng.uniform(0.2, 1.6), rng.uniform(0.2, 0.8)),))
    if kind == 1:  # a bin, a column, a plant
        angles_rad = np.linspace(0.0, 2.0 * np.pi, 10, endpoint=False)
        circle = np.stack([np.cos(angles_rad), np.sin(angles_rad)], axis=1)
        return Obstacle((T_m0_obstacle @ (rng.uniform(0.08, 0.35) * circle),))
    half_m = rng.uniform(0.2, 0.7, 2) / np.array([1.0, 1.5])
    corners = half_m * np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
    return Obstacle(tuple(T_m0_obstacle @ (corner + _box(0.05, 0.05)) for corner in corners))


def _box(length_m: float, width_m: float) -> Array:
    half = 0.5 * np.array([length_m, width_m])
    return half * np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])


def with_obstacles(grid: OccupancyGrid, obstacles: tuple[Obstacle, ...], T_m_m0: SE2) -> OccupancyGrid:
    """The map with the obstacles' outlines occupied and their inside unknown, where the map is known."""
    painted = grid.cells.copy()
    T_g_m0 = grid.T_m_g.inverse() @ T_m_m0
    for obstacle in obstacles:
        outlines = [_pixels(T_g_m0 @ outline / grid.resolution_m) for outline in obstacle.outlines_m]
        for outline in outlines:
            cv2.fillPoly(painted, [outline], UNKNOWN, cv2.LINE_8, _SUBPIXEL_BITS)
        cv2.polylines(painted, outlines, True, OCCUPIED, 1, cv2.LINE_8, _SUBPIXEL_BITS)
    return replace(grid, cells=np.where(grid.cells == UNKNOWN, np.uint8(UNKNOWN), painted))


def _pixels(col_row: Array) -> np.ndarray[tuple[int, ...], np.dtype[np.int32]]:
    """OpenCV's fixed-point pixels, whose integers are the centres of cells."""
    return np.round((col_row - 0.5) * 2**_SUBPIXEL_BITS).astype(np.int32)
