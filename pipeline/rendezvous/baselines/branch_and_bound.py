"""The best cell of a correlation, provably, without scoring every cell.

Branch and bound for correlative scan matching (Olson, "M3RSM: Many-to-many multi-resolution scan matching",
ICRA 2015; Hess et al., "Real-time loop closure in 2D lidar SLAM", ICRA 2016): a block of shifts scores at
most the sum, over the walls, of the field's maximum over that block. Blocks are opened best bound first, and
the search ends when the next bound is below the best score.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rendezvous.baselines.correlation import (
    BLOCK,
    LANES,
    Correlation,
    Field,
    Points,
    Scores,
    add_scores_in_place,
)
from rendezvous.compiled import njit
from rendezvous.geometry.se2 import wrap_angle

ShiftBox = tuple[int, int, int, int]  # first row, row after the last, first column, column after the last
NO_SHIFTS: ShiftBox = (0, 0, 0, 0)


@dataclass(frozen=True, slots=True, kw_only=True)
class ScoredCell:
    """A cell of a correlation."""

    score: int  # in units of 1 / SCORE_SCALE
    # heading, row, col: indices as `Correlation.scores` takes them.
    heading: int
    row: int
    col: int


@dataclass(frozen=True, slots=True, kw_only=True)
class Apart:
    """All cells except those around one: further in heading, or by more cells along rows or columns."""

    centre: ScoredCell
    yaw_rad: float
    cells: int

    def left_out(self, correlation: Correlation, heading: int) -> ShiftBox:
        """The shifts of a heading that are too close."""
        headings_rad = correlation.headings_rad
        turn_rad = wrap_angle(float(headings_rad[heading] - headings_rad[self.centre.heading]))
        if abs(turn_rad) > self.yaw_rad:
            return NO_SHIFTS
        row, col = self.centre.row, self.centre.col
        return row - self.cells, row + self.cells + 1, col - self.cells, col + self.cells + 1


def block_bounds(correlation: Correlation) -> Scores:
    """(H, B, B) int32: upper bound of the scores in block (row, col) of BLOCK x BLOCK shifts."""
    blocks = -(-(2 * correlation.reach + 1) // BLOCK)
    wide = LANES * -(-blocks // LANES)  # the processor adds that many at once
    bounds = np.zeros((len(correlation.headings_rad), blocks, wide), np.int32)
    maxima_0 = _block_maxima(correlation.field_0)
    for bound, walls_1, field_1 in zip(bounds, correlation.walls_1, correlation.fields_1, strict=True):
        _add_bounds_in_place(bound, maxima_0, walls_1)
        _add_bounds_in_place(bound, _block_maxima(field_1), correlation.walls_0)
    return bounds[:, :, :blocks]


def best_cell(
    correlation: Correlation, bounds: Scores, *, above: int = 0, apart: Apart | None = None
) -> ScoredCell | None:
    """The cell with the highest score; among equal ones the first by heading, then row, then column.

    Only cells count that score more than `above` and are `apart` from another one; None if there are none.
    """
    best: ScoredCell | None = None
    least = above + 1
    open_blocks = np.flatnonzero(bounds.ravel() >= least)
    order = open_blocks[np.argsort(-bounds.ravel()[open_blocks], kind="stable")]
    for heading, row, col in zip(*(i.tolist() for i in np.unravel_index(order, bounds.shape)), strict=True):
        if bounds[heading, row, col] < least:
            break
        cell = _best_of_block(correlation, heading, row, col, apart)
        if cell is not None and (cell.score > least or (cell.score == least and _is_before(cell, best))):
            best, least = cell, cell.score
    return best


def _is_before(cell: ScoredCell, other: ScoredCell | None) -> bool:
    return other is None or (cell.heading, cell.row, cell.col) < (other.heading, other.row, other.col)


def _best_of_block(
    correlation: Correlation, heading: int, row: int, col: int, apart: Apart | None
) -> ScoredCell | None:
    """The first best cell of a block within the range and `apart`."""
    left_out = NO_SHIFTS if apart is None else apart.left_out(correlation, heading)
    score, at_row, at_col = _best_in_block(
        (correlation.field_0, correlation.fields_1[heading]),
        (correlation.walls_1[heading], correlation.walls_0),
        row * BLOCK,
        col * BLOCK,
        2 * correlation.reach + 1,
        left_out,
    )
    return None if at_row < 0 else ScoredCell(score=score, heading=heading, row=at_row, col=at_col)


@njit
def _best_in_block(
    fields: tuple[Field, Field],
    walls: tuple[Points, Points],
    first_row: int,
    first_col: int,
    shifts: int,
    left_out: ShiftBox,
) -> tuple[int, int, int]:
    """Score, row and column; row -1 if the whole block is left out."""
    scores = np.zeros((min(BLOCK, shifts - first_row), min(BLOCK, shifts - first_col)), np.int32)
    best, best_row, best_col = 0, -1, -1
    add_scores_in_place(scores, fields[0], walls[0], first_row, first_col)
    add_scores_in_place(scores, fields[1], walls[1], first_row, first_col)
    for a in range(scores.shape[0]):
        for b in range(scores.shape[1]):
            row, col = first_row + a, first_col + b
            if left_out[0] <= row < left_out[1] and left_out[2] <= col < left_out[3]:
                continue
            if best_row < 0 or scores[a, b] > best:
                best, best_row, best_col = int(scores[a, b]), row, col
    return best, best_row, best_col


@njit
def _block_maxima(field: Field) -> Field:
    """(R, BLOCK, C / BLOCK): maxima of the BLOCK x BLOCK values from (row, col) on, at [row, col % BLOCK,
    col // BLOCK], so that whole-block steps along a row are adjacent."""
    rows, cols = field.shape
    maxima = field.copy()
    for reach in (1, 2):  # of 2 x 2 values, then of 4 x 4
        for row in range(rows - reach):
            line, below = maxima[row], maxima[row + reach]
            for col in range(cols):
                line[col] = max(line[col], below[col])
            for col in range(cols - reach):
                line[col] = max(line[col], line[col + reach])
    out = np.empty((rows, BLOCK, cols // BLOCK), np.int16)
    for row in range(rows):
        for phase in range(BLOCK):
            side_by_side, line = out[row, phase], maxima[row]
            for block in range(cols // BLOCK):
                side_by_side[block] = line[block * BLOCK + phase]
    return out


@njit
def _add_bounds_in_place(bounds: Scores, maxima: Field, points: Points) -> None:
    rows, cols = bounds.shape
    for i in range(len(points)):
        row, phase, block = points[i, 0], points[i, 1] % BLOCK, points[i, 1] // BLOCK
        for a in range(rows):
            line, total = maxima[row + a * BLOCK, phase, block : block + cols], bounds[a]
            for start in range(0, cols, LANES):
                for b in range(start, start + LANES):
                    total[b] += line[b]
