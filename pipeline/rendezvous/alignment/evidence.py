"""What two maps say of an alignment, counted: walls on walls, walls on floor, floor on floor, lines of sight.

A score that sums over cells grows with the overlap. These counts tell a large overlap that contradicts itself
from a small one that agrees.

Legend: T alignment, A map, W wall cell, N cells of the window.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

from rendezvous.alignment.window import FREE_CELL, HIDDEN_CELL, OCCUPIED_CELL, ROBOT_CELL, MapWindow
from rendezvous.compiled import njit
from rendezvous.geometry.occupancy_grid import Cells
from rendezvous.geometry.se2 import SE2, Array

COINCIDE_M, APART_M = 0.1, 0.15
"""Walls this close to one of the other map are the same; on its floor, farther from its walls than this, they
contradict it. What lies between is neither."""
NEARBY_M = 0.25  # the same, one for both, where alignments are only known to a coarse cell
EVIDENCE = ("walls_on_walls", "walls_on_floor", "floor_on_floor", "hidden_robots")
"""Logarithms of the lengths of wall, of both maps together [m], and of the area [m²], each with a bit added
(`_AT_LEAST`); the share of both robots that the other does not see, 0 to 2. Walls on what the other map does
not know count nowhere. Logarithms, because cells are no independent witnesses: neighbours err together."""
_AT_LEAST = np.array([0.5, 0.5, 1.0])


@dataclass(frozen=True, slots=True)
class WindowEvidence:
    """A window made ready to count the evidence of many alignments."""

    cells: Cells  # (2, N, N) of the window
    cell_m: float
    distance_m: tuple[Array, Array]  # (N, N) to the nearest wall of each map
    walls_m: tuple[Array, Array]  # (W, 2) centres of each map's wall cells in v
    floor_m: Array  # (M, 2) the same of every fourth floor cell of map 0
    robots_m: tuple[Array, Array] | None  # (M, 2) cells under each robot; None without a sighting
    sight: Cells | None

    @staticmethod
    def of(window: MapWindow, *, uses_sight: bool = True) -> WindowEvidence:
        """The window's evidence; without the robots if they are not to be used."""
        cells, cell_m = window.cells, window.cell_m
        sight = window.sight if uses_sight else None
        walls = cells == OCCUPIED_CELL
        far = np.full(cells.shape[1:], math.inf)
        distances = [distance_transform_edt(~wall) * cell_m if wall.any() else far for wall in walls]
        floor = np.zeros(cells.shape[1:], np.bool_)
        floor[::2, ::2] = cells[0, ::2, ::2] == FREE_CELL
        robots = None if sight is None else tuple(_centres(one == ROBOT_CELL, cell_m) for one in sight)
        return WindowEvidence(
            cells,
            cell_m,
            (distances[0], distances[1]),
            (_centres(walls[0], cell_m), _centres(walls[1], cell_m)),
            _centres(floor, cell_m),
            None if robots is None or not all(map(len, robots)) else (robots[0], robots[1]),
            sight,
        )

    def of_alignments(self, thetas: Sequence[SE2]) -> Array:
        """(T, 4) evidence of frame errors, in the order of `EVIDENCE`."""
        counted = np.array([self._of(theta) for theta in thetas]).reshape(-1, len(EVIDENCE))
        return np.column_stack([np.log(counted[:, :3] + _AT_LEAST), counted[:, 3]])

    def pooled(self, factor: int) -> Array:
        """(2, 3, N / factor, N / factor) of both maps: metres of wall in each block, and the shares of it
        that lie near walls and on floor away from them."""
        walls = (self.cells == OCCUPIED_CELL) * (self.cell_m * factor**2)
        near = np.stack([distance <= NEARBY_M for distance in self.distance_m])
        floor = (self.cells == FREE_CELL) & ~near
        layers = np.stack([walls, near, floor], 1).astype(np.float32)
        size = layers.shape[-1] // factor
        blocks: Array = layers.reshape(2, 3, size, factor, size, factor).mean(axis=(3, 5))
        return blocks

    def _of(self, theta: SE2) -> tuple[float, ...]:
        walls = np.zeros(2)
        hidden = 0.0
        # Map 1 as placed is θ applied to map 1 as it should lie.
        for a, b, T_b_a in ((0, 1, theta), (1, 0, theta.inverse())):
            motion = T_b_a.as_array()
            walls += _walls(
                self.walls_m[a], motion, self.distance_m[b], self.cells[b], self.cell_m, COINCIDE_M, APART_M
            )
            if self.robots_m is not None and self.sight is not None:
                seen = _codes(self.robots_m[a], motion, self.sight[b], self.cell_m)
                hidden += float((seen == HIDDEN_CELL).mean())
        floor = _codes(self.floor_m, theta.as_array(), self.cells[1], self.cell_m)
        area_m2 = float((floor == FREE_CELL).sum()) * 4.0 * self.cell_m**2
        return *(walls * self.cell_m), area_m2, hidden


def _centres(mask: NDArray[np.bool_], cell_m: float) -> Array:
    """(M, 2) centres of cells in v."""
    centres = (np.argwhere(mask)[:, ::-1] - (0.5 * len(mask) - 0.5)) * cell_m
    return np.ascontiguousarray(centres, np.float64)


@njit
def _walls(
    points_m: Array,
    motion: Array,
    distance_m: Array,
    cells: Cells,
    cell_m: float,
    near_m: float,
    far_m: float,
) -> Array:
    """(2,) number of moved points on the other map's walls, and on its floor away from them."""
    size, centre = cells.shape[0], 0.5 * cells.shape[0] - 0.5
    c, s = math.cos(motion[2]), math.sin(motion[2])
    out = np.zeros(2)
    for i in range(len(points_m)):
        x, y = points_m[i, 0], points_m[i, 1]
        col = math.floor((motion[0] + c * x - s * y) / cell_m + centre + 0.5)
        row = math.floor((motion[1] + s * x + c * y) / cell_m + centre + 0.5)
        if 0 <= row < size and 0 <= col < size:
            if distance_m[row, col] <= near_m + 1e-9:
                out[0] += 1.0
            elif distance_m[row, col] > far_m + 1e-9 and cells[row, col] == FREE_CELL:
                out[1] += 1.0
    return out


@njit
def _codes(points_m: Array, motion: Array, cells: Cells, cell_m: float) -> Cells:
    """(M,) cells under moved points; 0 outside."""
    size, centre = cells.shape[0], 0.5 * cells.shape[0] - 0.5
    c, s = math.cos(motion[2]), math.sin(motion[2])
    out = np.zeros(len(points_m), np.uint8)
    for i in range(len(points_m)):
        x, y = points_m[i, 0], points_m[i, 1]
        col = math.floor((motion[0] + c * x - s * y) / cell_m + centre + 0.5)
        row = math.floor((motion[1] + s * x + c * y) / cell_m + centre + 0.5)
        if 0 <= row < size and 0 <= col < size:
            out[i] = cells[row, col]
    return out


def coarse_evidence(walls_on_walls_m: Array, walls_on_floor_m: Array) -> Array:
    """(..., 2) the first two of `EVIDENCE` of lengths."""
    return np.log(np.stack([walls_on_walls_m, walls_on_floor_m], -1).clip(0.0) + _AT_LEAST[:2])
