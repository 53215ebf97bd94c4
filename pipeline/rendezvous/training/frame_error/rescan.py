"""Effects of a lidar's rays on a map: streaks and wedges between them, and fans that pass through walls."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from rendezvous.compiled import njit
from rendezvous.geometry.occupancy_grid import FREE, OCCUPIED, UNKNOWN, Cells, OccupancyGrid
from rendezvous.geometry.se2 import SE2, Array

Flags = NDArray[np.bool_]

_FAR_M = 12.0

_MARGIN_M = 2.0
"""How far beyond the map rays may leave traces."""

_HIT_BEYOND = 0.3
"""Share of the rays through a wall that end at an obstacle behind it."""


def rescanned(grid: OccupancyGrid, rng: np.random.Generator) -> OccupancyGrid:
    """The map as few scans of it would show it: cells that no ray crosses are unknown.

    4 to 16 scans from free cells; range uniform from 4 m to 12 m, field of view 180° to 360°, beams 0.35° to
    1.5° apart, as with lidars on small robots. Of the runs of up to ten neighbouring beams, up to 40 % do not
    come back (dark or shiny surfaces) and up to 3 % pass through the wall (glass, a door ajar).
    """
    starts = free_cells(grid, int(rng.integers(4, 17)), rng)
    if not len(starts):
        return grid
    reach_m, view_rad = rng.uniform(4.0, 12.0), rng.uniform(math.pi, 2.0 * math.pi)
    beams = max(8, int(view_rad / math.radians(rng.uniform(0.35, 1.5))))
    first_rad = rng.uniform(-math.pi, math.pi, (len(starts), 1))
    bearings_rad = first_rad + np.linspace(0.0, view_rad, beams)
    lost, through = _runs(bearings_rad.shape, rng.uniform(0.0, [0.4, 0.03]), rng)
    beyond_cells = _through_cells(grid, rng) * through.astype(np.float64)
    rays = _rays(starts, bearings_rad, reach_m / grid.resolution_m, beyond_cells)
    return _traced(grid, rays[~lost.ravel()], start_unknown=True, rng=rng)


def with_spurious_rays(grid: OccupancyGrid, rng: np.random.Generator) -> OccupancyGrid:
    """The map with one to six fans of rays through its walls, 1° to 12° wide, from free cells."""
    starts = free_cells(grid, int(rng.integers(1, 7)), rng)
    if not len(starts):
        return grid
    half_rad = np.radians(rng.uniform(0.5, 6.0, (len(starts), 1)))
    bearings_rad = rng.uniform(-math.pi, math.pi, (len(starts), 1)) + half_rad * np.linspace(-1.0, 1.0, 24)
    through = np.full(bearings_rad.shape, _through_cells(grid, rng))
    rays = _rays(starts, bearings_rad, _FAR_M / grid.resolution_m, through)
    return _traced(grid, rays, start_unknown=False, rng=rng)


def _runs(shape: tuple[int, int], shares: Array, rng: np.random.Generator) -> list[Flags]:
    """Flags of beams (scans, beams), one array for each share: equal within runs of neighbouring beams."""
    scans, beams = shape
    length = int(rng.integers(1, 11))
    draws = np.repeat(rng.random((scans, beams // length + 1)), length, axis=1)[:, :beams]
    edges = np.concatenate([[0.0], np.cumsum(shares)])
    return [(draws >= low) & (draws < high) for low, high in pairwise(edges)]


def _traced(
    grid: OccupancyGrid, rays: Array, *, start_unknown: bool, rng: np.random.Generator
) -> OccupancyGrid:
    """The map, or an unknown one, with the traces of rays, on a grid with a margin for them."""
    margin = math.ceil(_MARGIN_M / grid.resolution_m)
    source = np.pad(grid.cells, margin, constant_values=UNKNOWN)
    cells = np.full_like(source, UNKNOWN) if start_unknown else source.copy()
    _trace_in_place(cells, source, rays + np.array([margin, margin, 0.0, 0.0, 0.0]), rng)
    back_m = -margin * grid.resolution_m
    return OccupancyGrid(
        cells=cells, resolution_m=grid.resolution_m, T_m_g=grid.T_m_g @ SE2(back_m, back_m, 0.0)
    )


def free_cells(grid: OccupancyGrid, count: int, rng: np.random.Generator) -> Array:
    """(count or 0, 2) row, col of the centres of free cells."""
    free = np.flatnonzero(grid.cells.ravel() == FREE)
    if not len(free):
        return np.empty((0, 2))
    drawn = free[rng.integers(0, len(free), count)]
    return np.stack(np.divmod(drawn, grid.cells.shape[1]), axis=1) + 0.5


def _through_cells(grid: OccupancyGrid, rng: np.random.Generator) -> float:
    return float(rng.uniform(0.5, 5.0) / grid.resolution_m)


def _rays(starts: Array, bearings_rad: Array, reach_cells: float, through_cells: Array) -> Array:
    """(N, 5) row, col, bearing, range and distance to go on behind a wall [cells]."""
    beams = bearings_rad.shape[1]
    return np.column_stack(
        [
            np.repeat(starts, beams, axis=0),
            bearings_rad.ravel(),
            np.full(bearings_rad.size, reach_cells),
            through_cells.ravel(),
        ]
    )


@njit(nogil=True)
def _trace_in_place(out: Cells, source: Cells, rays: Array, rng: np.random.Generator) -> None:
    """Mark cells that a ray crosses as free and the one that stops it as occupied.

    From cell to cell as in Amanatides & Woo (1987). A ray stops at the source's occupied and unknown cells;
    one that passes through goes on over any cell.
    """
    height, width = source.shape
    for ray in range(rays.shape[0]):
        y, x, bearing, reach, beyond = rays[ray]
        row, col = int(y), int(x)
        dy, dx = math.sin(bearing), math.cos(bearing)
        row_step, col_step = (1 if dy > 0.0 else -1), (1 if dx > 0.0 else -1)
        row_gap = 1.0 / max(abs(dy), 1e-9)
        col_gap = 1.0 / max(abs(dx), 1e-9)
        next_row = row_gap * ((row + 1 - y) if dy > 0.0 else (y - row))
        next_col = col_gap * ((col + 1 - x) if dx > 0.0 else (x - col))
        end, stops, gone = reach, True, 0.0
        while gone < end and 0 <= row < height and 0 <= col < width:
            value = source[row, col]
            if stops and value != FREE:
                if beyond <= 0.0:
                    if value == OCCUPIED:
                        out[row, col] = OCCUPIED
                    break
                stops, end = False, gone + beyond * (0.5 + 0.5 * rng.random())
            if not stops or out[row, col] != OCCUPIED:
                out[row, col] = FREE
            if next_row < next_col:
                gone, next_row, row = next_row, next_row + row_gap, row + row_step
            else:
                gone, next_col, col = next_col, next_col + col_gap, col + col_step
        if not stops and rng.random() < _HIT_BEYOND and 0 <= row < height and 0 <= col < width:
            out[row, col] = OCCUPIED
