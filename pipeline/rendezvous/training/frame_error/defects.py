"""Defects of one map: bent by its SLAM, redrawn in other cells, thick or ragged walls, holes, patches, an
end."""

from __future__ import annotations

import math
from dataclasses import replace

import cv2
import numpy as np

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
