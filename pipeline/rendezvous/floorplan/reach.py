"""Rectangles and solids on a grid, and whether the cells that a robot reaches stay connected.

Cells have side 1 here: all lengths are in cells, the centre of cell (row, col) is (col + 0.5, row + 0.5).
A rectangle or box is x, y, yaw [rad], half_x, half_y; a cylinder the same with its radius as both halves.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from rendezvous.compiled import njit
from rendezvous.geometry.occupancy_grid import Cells
from rendezvous.geometry.se2 import Array

Regions = NDArray[np.int32]
VACANT, WALL, DOORWAY, FURNITURE = 0, 1, 2, 3  # why a cell is taken, if it is
HALF_DIAGONAL = 0.71


@njit
def first_vacant(taken: Cells, rectangles: Array, first: int, slack: float) -> int:
    """Index, from `first` on, of a rectangle (N, 5) whose place is vacant; N if there is none.

    A place is vacant if the rectangle, grown by half a cell's diagonal, holds no centre of a taken cell. It
    may reach into cells that a wall touches, by the slack: a cupboard stands right at the wall.
    """
    for n in range(first, len(rectangles)):
        if _is_vacant(taken, rectangles[n], slack):
            return n
    return len(rectangles)


@njit
def _is_vacant(taken: Cells, rectangle: Array, slack: float) -> bool:
    row0, row1, col0, col1 = _window(taken.shape, rectangle, 1.0)
    for row in range(row0, row1):
        for col in range(col0, col1):
            if taken[row, col]:
                along, aside = _offset(rectangle, row, col)
                grow = -slack if taken[row, col] == WALL else HALF_DIAGONAL
                if along <= max(rectangle[3] + grow, 0.5) and aside <= max(rectangle[4] + grow, 0.5):
                    return False
    return True


@njit
def furnish_in_place(taken: Cells, rectangle: Array) -> None:
    """Mark every cell that a rectangle (5,) touches as taken by furniture."""
    row0, row1, col0, col1 = _window(taken.shape, rectangle, 1.0)
    for row in range(row0, row1):
        for col in range(col0, col1):
            along, aside = _offset(rectangle, row, col)
            if along <= rectangle[3] + HALF_DIAGONAL and aside <= rectangle[4] + HALF_DIAGONAL:
                taken[row, col] = FURNITURE


def admit_in_place(
    reachable: Cells,
    region_of_cell: Regions,
    region_left: NDArray[np.int64],
    region_least: NDArray[np.int64],
    boxes: Array,
    cylinders: Array,
    rectangle: Array,
    clearance: float,
    max_pocket: int,
) -> bool:
    """Take the cells that a piece covers out of `reachable`, unless that would part it or fill a region.

    A small window around the piece decides: if all that leaves the window is one part, nothing beyond is cut
    off. Parts that do not leave the window are pockets; they are given up if they are small.

    `reachable` (H, W), where the robot's centre can be, and `region_left` (R + 1,), the reachable cells of
    each start region, change if the piece is admitted. Pockets within the rectangle around the piece do not
    count.
    """
    row0, row1, col0, col1 = _window(reachable.shape, rectangle, clearance + 2.0)
    window = slice(row0, row1), slice(col0, col1)
    before = reachable[window]
    after = before.copy()
    _clear_in_place(after, (row0, col0), boxes, clearance, False)
    _clear_in_place(after, (row0, col0), cylinders, clearance, True)
    count, labels = cv2.connectedComponents(after, connectivity=4)
    leaves = np.zeros(count, np.bool_)
    for side in (labels[0], labels[-1], labels[:, 0], labels[:, -1]):
        leaves[side] = True
    leaves[0] = False
    kept, parts = leaves[labels], np.count_nonzero(leaves)
    if parts == 0 or (parts > 1 and not _is_one_part(reachable, window, kept)):
        return False
    lost = (before > 0) & ~kept
    row, col = np.nonzero(lost & (labels > 0))
    pocket = _count_outside(rectangle, row0 + row, col0 + col)
    left = region_left - np.bincount(region_of_cell[window][lost], minlength=len(region_left))
    if pocket > max_pocket or (left[1:] < region_least[1:]).any():
        return False
    region_left[:] = left
    before[:] = kept
    return True


def _is_one_part(reachable: Cells, window: tuple[slice, slice], kept: NDArray[np.bool_]) -> bool:
    """Whether the cells kept in the window are joined by ways inside or outside it."""
    trial = reachable.copy()
    trial[window] = kept
    _, labels = cv2.connectedComponents(trial, connectivity=4)
    return bool(np.ptp(labels[window][kept]) == 0)


@njit(inline="always")
def _offset(rectangle: Array, row: int, col: int) -> tuple[float, float]:
    """Distance of a cell's centre from a rectangle's middle, along its x and its y."""
    cos, sin = np.cos(rectangle[2]), np.sin(rectangle[2])
    dx, dy = col + 0.5 - rectangle[0], row + 0.5 - rectangle[1]
    return abs(cos * dx + sin * dy), abs(cos * dy - sin * dx)


@njit
def _count_outside(rectangle: Array, rows: NDArray[np.int64], cols: NDArray[np.int64]) -> int:
    count = 0
    for row, col in zip(rows, cols):  # noqa: B905
        along, aside = _offset(rectangle, row, col)
        count += along > rectangle[3] or aside > rectangle[4]
    return count


@njit
def _window(shape: tuple[int, int], rectangle: Array, margin: float) -> tuple[int, int, int, int]:
    """First row, last row + 1, first column, last column + 1 of the cells around a rectangle (5,)."""
    x, y, yaw, half_x, half_y = rectangle
    cos, sin = abs(np.cos(yaw)), abs(np.sin(yaw))
    reach_x, reach_y = cos * half_x + sin * half_y + margin, sin * half_x + cos * half_y + margin
    row0, row1 = max(int(np.floor(y - reach_y)), 0), min(int(np.ceil(y + reach_y)), shape[0])
    col0, col1 = max(int(np.floor(x - reach_x)), 0), min(int(np.ceil(x + reach_x)), shape[1])
    return row0, row1, col0, col1


@njit
def _clear_in_place(
    cells: Cells, corner: tuple[int, int], solids: Array, clearance: float, is_cylinder: bool
) -> None:
    """Zero the cells of a window whose centres are nearer to a solid (N, 5) than the clearance."""
    for n in range(len(solids)):
        solid = solids[n].copy()
        solid[0] -= corner[1]
        solid[1] -= corner[0]
        row0, row1, col0, col1 = _window(cells.shape, solid, clearance)
        least = clearance
        if is_cylinder:
            least += solid[3]
            solid[3:] = 0.0
        for row in range(row0, row1):
            for col in range(col0, col1):
                along, aside = _offset(solid, row, col)
                along, aside = max(along - solid[3], 0.0), max(aside - solid[4], 0.0)
                if along * along + aside * aside < least * least:
                    cells[row, col] = 0
