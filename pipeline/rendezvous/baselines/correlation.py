"""How well two maps agree under a rigid motion: one integer score for every heading and whole-cell shift.

For a frame error θ = (R_ψ s, ψ) the score sums, over the walls of either map, the other map's field where
they fall: `Σ_u wall_0(u) field_1(R_ψ (u + s)) + Σ_u field_0(u) wall_1(R_ψ (u + s))`. A field is near 1 close
to a wall (Thrun's likelihood field), 0 in the unknown and negative on free floor: a wall on floor that the
other robot saw empty speaks against the motion, so that maps of little overlap are not pulled over each
other. Scores are integers, so that two searches of the same scores find the very same cell.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from rendezvous.alignment.window import FREE_CELL, OCCUPIED_CELL, MapWindow, SearchRange
from rendezvous.compiled import njit
from rendezvous.geometry.occupancy_grid import Cells
from rendezvous.geometry.se2 import SE2, Array

SCORE_SCALE = 100  # score of one wall cell exactly on a wall
BLOCK = 4  # side of the blocks of shifts that are bounded together [cells]; padding is a multiple of it
LANES = 8  # number of blocks along a row that are bounded at once
Field = NDArray[np.int16]
Points = NDArray[np.int32]
Scores = NDArray[np.int32]


@dataclass(frozen=True, slots=True, kw_only=True)
class Correlation:
    """All that is needed to score any motion of a search range.

    Shift (row, col), each from 0 to 2 reach, stands for `s = (col - reach, row - reach) * cell_m`. Both sums
    have the form `Σ field[point + shift]`; the one over map 1's walls is mirrored to bring it to that form.
    """

    headings_rad: Array  # (H,) ψ
    reach: int  # largest shift [cells]
    cell_m: float  # side of a cell [m]
    field_0: Field  # (S0, S0) field of map 0, mirrored and padded with 0
    walls_1: list[Points]  # per heading, (P, 2) row, col into field_0 of map 1's walls turned by -ψ, mirrored
    fields_1: Field  # (H, R1, C1) field of map 1 turned by -ψ, padded with 0 as far as map 0's walls shift
    walls_0: Points  # (P, 2) row, col into fields_1 of map 0's walls

    def scores(self, heading: int, row: int, col: int, rows: int, cols: int) -> Scores:
        """(rows, cols) int32 scores of a block of shifts at one heading."""
        out = np.zeros((rows, cols), np.int32)
        add_scores_in_place(out, self.field_0, self.walls_1[heading], row, col)
        add_scores_in_place(out, self.fields_1[heading], self.walls_0, row, col)
        return out

    def theta(self, heading: float, row: float, col: float) -> SE2:
        """The frame error of a cell; also between cells."""
        step_rad = self.headings_rad[1] - self.headings_rad[0] if len(self.headings_rad) > 1 else 0.0
        yaw_rad = float(self.headings_rad[0] + heading * step_rad)
        shift_m = self.cell_m * np.array([col - self.reach, row - self.reach])
        x_m, y_m = SE2(0.0, 0.0, yaw_rad) @ shift_m
        return SE2(float(x_m), float(y_m), yaw_rad)


def correlation(
    window: MapWindow, search: SearchRange, *, heading_step_rad: float, blur_m: float, free_penalty: float
) -> Correlation:
    """Prepare the scores of all motions in a range, in the window's cells.

    A wall is a Gaussian of deviation `blur_m`; one on free floor costs `free_penalty`, one on a wall counts
    1. A search of pi or more is of every heading, in steps of at most `heading_step_rad`.
    """
    size, reach = window.cells.shape[1], math.ceil(search.xy_m / window.cell_m - 1e-9)
    headings_rad = _headings(search.yaw_rad, heading_step_rad)
    field_0, field_1 = (
        likelihood_field(cells, blur_cells=blur_m / window.cell_m, free_penalty=free_penalty)
        for cells in window.cells
    )
    mirrored = np.zeros((_padded(size + 4 * reach),) * 2, np.int16)
    mirrored[2 * reach : 2 * reach + size, 2 * reach : 2 * reach + size] = field_0[::-1, ::-1]
    walls_0 = np.argwhere(window.cells[0] == OCCUPIED_CELL).astype(np.int32).reshape(-1, 2)
    first = walls_0.min(axis=0, initial=size)
    extent = np.maximum(walls_0.max(axis=0, initial=0) - first + 1, 0)
    fields_1 = np.zeros((len(headings_rad), *(_padded(int(n) + 2 * reach) for n in extent)), np.int16)
    walls_1 = []
    centres_1 = np.argwhere(window.cells[1] == OCCUPIED_CELL)[:, ::-1] + (0.5 - size / 2)
    for field, yaw_rad in zip(fields_1, headings_rad, strict=True):
        within = field[: extent[0] + 2 * reach, : extent[1] + 2 * reach]
        _turn_field_in_place(within, field_1, yaw_rad, first[0] - reach, first[1] - reach)
        walls_1.append(_turned_walls(centres_1, size, yaw_rad, reach))
    return Correlation(
        headings_rad=headings_rad,
        reach=reach,
        cell_m=window.cell_m,
        field_0=mirrored,
        walls_1=walls_1,
        fields_1=fields_1,
        walls_0=np.ascontiguousarray(walls_0 - first.astype(np.int32)),
    )


def likelihood_field(cells: Cells, *, blur_cells: float, free_penalty: float) -> Field:
    """(N, N) int16: value of a wall of the other map at each cell, times SCORE_SCALE."""
    occupied = cells == OCCUPIED_CELL
    if not occupied.any():
        near = np.zeros(cells.shape)
    else:
        away_cells = cv2.distanceTransform((~occupied).astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
        near = np.exp(-0.5 * np.square(away_cells / blur_cells))
    value = np.where(cells == FREE_CELL, near - free_penalty * (1.0 - near), near)
    return np.rint(SCORE_SCALE * value).astype(np.int16)


def _headings(yaw_rad: float, step_rad: float) -> Array:
    """(H,) from -yaw to yaw, or the full circle without its seam twice."""
    if yaw_rad >= math.pi:
        return np.linspace(-math.pi, math.pi, 2 * math.ceil(math.pi / step_rad - 1e-9), endpoint=False)
    return np.linspace(-yaw_rad, yaw_rad, 2 * math.ceil(yaw_rad / step_rad - 1e-9) + 1)


def _padded(size: int) -> int:
    """Size with room for the last blocks, in full lanes, to look beyond the last shift."""
    return BLOCK * (-(-size // BLOCK) + LANES)


@njit
def _turn_field_in_place(out: Field, field: Field, yaw_rad: float, first_row: int, first_col: int) -> None:
    """Nearest cell of the field at R_ψ u, for u from the first row and column on."""
    size, half = field.shape[0], 0.5 * field.shape[0]
    c, s = math.cos(yaw_rad), math.sin(yaw_rad)
    for row in range(out.shape[0]):
        y = row + first_row + 0.5 - half
        x0, y0, line = half - s * y, half + c * y, out[row]
        for col in range(out.shape[1]):
            x = col + first_col + 0.5 - half
            col_1, row_1 = math.floor(x0 + c * x), math.floor(y0 + s * x)
            if 0 <= row_1 < size and 0 <= col_1 < size:
                line[col] = field[row_1, col_1]


@njit
def _turned_walls(centres: Array, size: int, yaw_rad: float, reach: int) -> Points:
    """The distinct cells into which walls fall when turned by -ψ, mirrored, and numbered as in `field_0`."""
    c, s, end = math.cos(yaw_rad), math.sin(yaw_rad), size + 2 * reach
    taken = np.zeros((end, end), np.bool_)
    out = np.empty((len(centres), 2), np.int32)
    count = 0
    for x, y in centres:
        col = size - 1 - math.floor(0.5 * size + c * x + s * y) + reach
        row = size - 1 - math.floor(0.5 * size - s * x + c * y) + reach
        if 0 <= row < end and 0 <= col < end and not taken[row, col]:
            taken[row, col] = True
            out[count, 0], out[count, 1] = row, col
            count += 1
    return out[:count]


@njit
def add_scores_in_place(out: Scores, field: Field, points: Points, row: int, col: int) -> None:
    """Add `Σ field[point + shift]` for shifts (rows, cols) starting at this row and column."""
    rows, cols = out.shape
    for i in range(len(points)):
        first_row, first_col = points[i, 0] + row, points[i, 1] + col
        for a in range(rows):
            line = field[first_row + a, first_col : first_col + cols]
            total = out[a]
            for b in range(cols):
                total[b] += line[b]
