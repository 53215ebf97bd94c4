"""Defects of one map: those of its SLAM and its walls (bent, redrawn in other cells, thick, ragged, holes,
patches, an end), and those of a lidar's rays (streaks and wedges between them, fans through walls)."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import pairwise

import cv2
import numpy as np
from numpy.typing import NDArray

from rendezvous.compiled import njit
from rendezvous.geometry.occupancy_grid import FREE, OCCUPIED, UNKNOWN, Cells, OccupancyGrid
from rendezvous.geometry.se2 import SE2, Array

_WAVES = 2
_BLOCK_CELLS = 6
_CROSS = cv2.getStructuringElement(cv2.MORPH_CROSS, (3, 3))


def bent(
    grid: OccupancyGrid, T_m_fixed: SE2, *, amplitude_m: float, resolution_m: float, rng: np.random.Generator
) -> OccupancyGrid:
    """The map bent by smooth waves and redrawn in cells of another size on a shifted grid; no wall is
    lost.

    Waves run along each axis and move cells across it; their length is uniform from 2 m to 8 m, and their
    amplitudes are uniform and sum to at most `amplitude_m`. Their value at `T_m_fixed` is subtracted, so that
    nothing moves there, where the label of a pair is exact. The new grid starts at a uniform place within an
    old cell: otherwise a move of less than half a cell would change nothing.
    """
    ratio = resolution_m / grid.resolution_m
    phase = rng.random(2)
    shape = tuple(math.ceil((n + 1) / ratio) for n in grid.cells.shape)
    T_g_fixed = grid.T_m_g.inverse() @ T_m_fixed
    row_moves, col_moves = (
        _waves(n, at_m, amplitude_m / grid.resolution_m, grid.resolution_m, rng)
        for n, at_m in zip(reversed(grid.cells.shape), (T_g_fixed.x_m, T_g_fixed.y_m), strict=True)
    )
    cells = np.full(shape, UNKNOWN, np.uint8)
    _resample_in_place(cells, grid.cells, ratio, row_moves + phase[0], col_moves + phase[1])
    row_m, col_m = (-grid.resolution_m * phase).tolist()
    return OccupancyGrid(cells=cells, resolution_m=resolution_m, T_m_g=grid.T_m_g @ SE2(col_m, row_m, 0.0))


def _waves(
    cells: int, still_m: float, amplitude_cells: float, resolution_m: float, rng: np.random.Generator
) -> Array:
    """(cells,) displacement [cells] along one axis, zero at one place on it."""
    place_m = np.append(resolution_m * (np.arange(cells) + 0.5), still_m)
    waves = [
        rng.uniform(0.0, amplitude_cells / _WAVES)
        * np.sin(2.0 * np.pi * (place_m / rng.uniform(2.0, 8.0) + rng.random()))
        for _ in range(_WAVES)
    ]
    moves = np.asarray(np.sum(waves, axis=0), dtype=np.float64)
    return moves[:-1] - moves[-1]


@njit(nogil=True)
def _resample_in_place(out: Cells, source: Cells, ratio: float, row_moves: Array, col_moves: Array) -> None:
    """Nearest cell, and each occupied cell also where it falls; `row_moves` depend on the column."""
    height, width = source.shape
    for row in range(out.shape[0]):
        for col in range(out.shape[1]):
            y, x = (row + 0.5) * ratio, (col + 0.5) * ratio
            near_row, near_col = min(int(y), height - 1), min(int(x), width - 1)
            from_row = math.floor(y - row_moves[near_col])
            from_col = math.floor(x - col_moves[near_row])
            if 0 <= from_row < height and 0 <= from_col < width:
                out[row, col] = source[from_row, from_col]
    for row in range(height):
        for col in range(width):
            if source[row, col] == OCCUPIED:
                to_row = math.floor((row + 0.5 + row_moves[col]) / ratio)
                to_col = math.floor((col + 0.5 + col_moves[row]) / ratio)
                if 0 <= to_row < out.shape[0] and 0 <= to_col < out.shape[1]:
                    out[to_row, to_col] = OCCUPIED


def thickened(grid: OccupancyGrid, rng: np.random.Generator) -> OccupancyGrid:
    """Walls one cell thicker on both sides, or only on one."""
    kernel = _CROSS if rng.random() < 0.5 else np.ones((2, 2), np.uint8)
    occupied = cv2.dilate(grid.occupied().astype(np.uint8), kernel)
    return replace(grid, cells=np.where(occupied > 0, np.uint8(OCCUPIED), grid.cells))


def ragged(grid: OccupancyGrid, rng: np.random.Generator) -> OccupancyGrid:
    """Wall cells dropped and neighbours of wall cells grown; some stretches of wall suffer much more than
    others."""
    cells = grid.cells.copy()
    blocks = tuple(n // _BLOCK_CELLS + 1 for n in cells.shape)
    # A fifth of the blocks loses most of its wall: glass, shiny surfaces, low things seen now and then.
    drop = np.where(rng.random(blocks) < 0.2, rng.uniform(0.2, 0.9), rng.uniform(0.0, 0.25))
    _wear_in_place(cells, grid.cells, drop, rng.uniform(0.0, 0.2), rng)
    return replace(grid, cells=cells)


@njit(nogil=True)
def _wear_in_place(out: Cells, source: Cells, drop: Array, grow: float, rng: np.random.Generator) -> None:
    height, width = source.shape
    for row in range(height):
        for col in range(width):
            if source[row, col] != OCCUPIED:
                continue
            if rng.random() < drop[row // _BLOCK_CELLS, col // _BLOCK_CELLS]:
                out[row, col] = FREE if rng.random() < 0.5 else UNKNOWN
            elif rng.random() < grow:
                to_row = min(max(row + int(3.0 * rng.random()) - 1, 0), height - 1)
                to_col = min(max(col + int(3.0 * rng.random()) - 1, 0), width - 1)
                out[to_row, to_col] = OCCUPIED


def patched(grid: OccupancyGrid, rng: np.random.Generator) -> OccupancyGrid:
    """One to five patches become unknown: discs of 0.2 to 1 m, and triangles like a missing wedge."""
    cells = grid.cells.copy()
    height, width = cells.shape
    for _ in range(int(rng.integers(1, 6))):
        col, row = int(rng.integers(width)), int(rng.integers(height))
        if rng.random() < 0.5:
            cv2.circle(cells, (col, row), int(rng.uniform(0.2, 1.0) / grid.resolution_m), UNKNOWN, -1)
            continue
        headings_rad = rng.uniform(-np.pi, np.pi) + np.array([0.0, rng.uniform(0.05, 0.5)])
        length = rng.uniform(0.5, 5.0) / grid.resolution_m
        ends = length * np.stack([np.cos(headings_rad), np.sin(headings_rad)], axis=1)
        corners = np.round(np.array([col, row]) + np.vstack([[0.0, 0.0], ends])).astype(np.int32)
        cv2.fillConvexPoly(cells, corners, UNKNOWN)
    return replace(grid, cells=cells)


def specked(grid: OccupancyGrid, rng: np.random.Generator) -> OccupancyGrid:
    """Up to 3 % of the free cells become unknown, up to 0.2 % occupied, drawn one by one."""
    cells = grid.cells.copy()
    free = np.flatnonzero(cells.ravel() == FREE)
    for value, most in ((UNKNOWN, 0.03), (OCCUPIED, 0.002)):
        count = int(rng.uniform(0.0, most) * len(free))
        cells.ravel()[free[rng.integers(0, max(len(free), 1), count)]] = value
    return replace(grid, cells=cells)


def beyond_line_unknown(grid: OccupancyGrid, T_m_line: SE2) -> OccupancyGrid:
    """The map without what lies ahead (x > 0) of a line's frame."""
    T_line_g = T_m_line.inverse() @ grid.T_m_g
    height, width = grid.cells.shape
    c, s = math.cos(T_line_g.yaw_rad), math.sin(T_line_g.yaw_rad)
    col_m = grid.resolution_m * (np.arange(width) + 0.5)
    row_m = grid.resolution_m * (np.arange(height) + 0.5)
    ahead = T_line_g.x_m + c * col_m[None] - s * row_m[:, None] > 0.0
    return replace(grid, cells=np.where(ahead, np.uint8(UNKNOWN), grid.cells))


Flags = NDArray[np.bool_]

_FAR_M = 12.0

_MARGIN_M = 2.0  # how far beyond the map rays may leave traces

_HIT_BEYOND = 0.3  # share of the rays through a wall that end at an obstacle behind it


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
