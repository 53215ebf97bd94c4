"""Inner loops of furnishing: rectangles and solids on a grid, and whether what is reachable stays connected.

Cells have side 1 here: all lengths are in cells, the centre of cell (row, col) is (col + 0.5, row + 0.5).
A rectangle or box is x, y, yaw [rad], half_x, half_y; a cylinder the same with its radius as both halves.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rendezvous.compiled import njit
from rendezvous.geometry.se2 import Array

Mask = NDArray[np.uint8]
Regions = NDArray[np.int32]

VACANT, WALL, DOORWAY, FURNITURE = 0, 1, 2, 3
"""What takes a cell."""

HALF_DIAGONAL = 0.71


@njit
def first_vacant(taken: Mask, rectangles: Array, first: int, slack: float) -> int:
    """Index, from `first` on, of a rectangle (N, 5) with nothing in its place; N if there is none.

    A rectangle touches what is in its place if it grown by half a cell's diagonal holds the centre of a cell
    taken. It may reach into cells that a wall touches, by the slack: a cupboard stands right at the wall.
    """
    for n in range(first, len(rectangles)):
        x, y, yaw, half_x, half_y = rectangles[n]
        row0, row1, col0, col1 = _window(taken.shape, rectangles[n], 1.0)
        cos, sin = np.cos(yaw), np.sin(yaw)
        vacant = True
        for row in range(row0, row1):
            for col in range(col0, col1):
                if taken[row, col]:
                    dx, dy = col + 0.5 - x, row + 0.5 - y
                    along, aside = abs(cos * dx + sin * dy), abs(cos * dy - sin * dx)
                    grow = -slack if taken[row, col] == WALL else HALF_DIAGONAL
                    if along <= max(half_x + grow, 0.5) and aside <= max(half_y + grow, 0.5):
                        vacant = False
                        break
            if not vacant:
                break
        if vacant:
            return n
    return len(rectangles)


@njit
def furnish_in_place(taken: Mask, rectangle: Array) -> None:
    """Mark every cell that a rectangle (5,) touches as taken by furniture."""
    x, y, yaw, half_x, half_y = rectangle
    row0, row1, col0, col1 = _window(taken.shape, rectangle, 1.0)
    cos, sin = np.cos(yaw), np.sin(yaw)
    for row in range(row0, row1):
        for col in range(col0, col1):
            dx, dy = col + 0.5 - x, row + 0.5 - y
            along, aside = abs(cos * dx + sin * dy), abs(cos * dy - sin * dx)
            if along <= half_x + HALF_DIAGONAL and aside <= half_y + HALF_DIAGONAL:
                taken[row, col] = FURNITURE


@njit
def admit_in_place(
    reachable: Mask,
    region_of_cell: Regions,
    region_left: NDArray[np.int64],
    region_least: NDArray[np.int64],
    boxes: Array,
    cylinders: Array,
    rectangle: Array,
    clearance: float,
    max_pocket: int,
) -> bool:
    """Take what a piece covers out of `reachable`, unless that would part it or fill a start region.

    A small window around the piece decides: if all that leaves the window is one part, nothing beyond is cut
    off. Parts that do not leave the window are pockets; they are given up if they are small.

    Args:
        reachable: (H, W) where the robot's centre can be; changed if the piece is admitted.
        region_of_cell: (H, W) start region of each cell, 0 for none.
        region_left: (R + 1,) reachable cells per start region; changed if the piece is admitted.
        region_least: (R + 1,) what must be left of each.
        boxes, cylinders: (B, 5), (C, 5) what stands on the floor.
        rectangle: (5,) around the piece; pockets within it do not count.
        clearance: least distance from a solid to the robot's centre.
        max_pocket: most cells in pockets.

    Returns:
        Whether the piece was admitted.
    """
    row0, row1, col0, col1 = _window(reachable.shape, rectangle, clearance + 2.0)
    before = reachable[row0:row1, col0:col1]
    after = before.copy()
    for n in range(len(boxes)):
        _clear_in_place(after, row0, col0, boxes[n], clearance, False)
    for n in range(len(cylinders)):
        _clear_in_place(after, row0, col0, cylinders[n], clearance, True)
    labels, leaves = _components(after)
    if not leaves.any():
        return False
    if leaves.sum() > 1 and not _joined_outside(reachable, labels, leaves, row0, col0):
        return False
    lost = np.zeros(len(region_left), np.int64)
    regions = region_of_cell[row0:row1, col0:col1]
    pocket = _count_losses_in_place(lost, before, labels, leaves, regions, rectangle, row0, col0)
    if pocket > max_pocket or (region_left[1:] - lost[1:] < region_least[1:]).any():
        return False
    region_left -= lost
    for row in range(row1 - row0):
        for col in range(col1 - col0):
            before[row, col] = labels[row, col] > 0 and leaves[labels[row, col]]
    return True


@njit
def _count_losses_in_place(
    lost: NDArray[np.int64],
    before: Mask,
    labels: NDArray[np.int32],
    leaves: NDArray[np.bool_],
    region_of_cell: Regions,
    rectangle: Array,
    row0: int,
    col0: int,
) -> int:
    """Add up the reachable cells that a window loses, by start region; those in pockets are returned."""
    x, y, yaw, half_x, half_y = rectangle
    cos, sin = np.cos(yaw), np.sin(yaw)
    pocket = 0
    for row in range(before.shape[0]):
        for col in range(before.shape[1]):
            label = labels[row, col]
            if not before[row, col] or (label > 0 and leaves[label]):
                continue
            lost[region_of_cell[row, col]] += 1
            dx, dy = col0 + col + 0.5 - x, row0 + row + 0.5 - y
            within = abs(cos * dx + sin * dy) <= half_x and abs(cos * dy - sin * dx) <= half_y
            pocket += label > 0 and not within
    return pocket


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
    cells: Mask, row0: int, col0: int, solid: Array, clearance: float, is_cylinder: bool
) -> None:
    """Zero the cells of a window whose centres are nearer to a solid than the clearance."""
    moved = solid.copy()
    moved[0] -= col0
    moved[1] -= row0
    row_first, row_end, col_first, col_end = _window(cells.shape, moved, clearance)
    x, y, yaw, half_x, half_y = moved
    if is_cylinder:
        clearance, half_x, half_y = clearance + half_x, 0.0, 0.0
    cos, sin = np.cos(yaw), np.sin(yaw)
    for row in range(row_first, row_end):
        for col in range(col_first, col_end):
            dx, dy = col + 0.5 - x, row + 0.5 - y
            along = max(abs(cos * dx + sin * dy) - half_x, 0.0)
            aside = max(abs(cos * dy - sin * dx) - half_y, 0.0)
            if along * along + aside * aside < clearance * clearance:
                cells[row, col] = 0


@njit
def _components(cells: Mask) -> tuple[NDArray[np.int32], NDArray[np.bool_]]:
    """4-connected components, numbered from 1, and which of them touch the rim."""
    height, width = cells.shape
    labels = np.zeros((height, width), np.int32)
    leaves = np.zeros(height * width + 1, np.bool_)
    stack = np.empty(height * width, np.int64)
    count = 0
    for start in range(height * width):
        if not cells[start // width, start % width] or labels[start // width, start % width]:
            continue
        count += 1
        labels[start // width, start % width] = count
        stack[0], top = start, 1
        while top > 0:
            top -= 1
            row, col = stack[top] // width, stack[top] % width
            leaves[count] |= row == 0 or col == 0 or row == height - 1 or col == width - 1
            for next_row, next_col in ((row - 1, col), (row + 1, col), (row, col - 1), (row, col + 1)):
                if not (0 <= next_row < height and 0 <= next_col < width):
                    continue
                if cells[next_row, next_col] and not labels[next_row, next_col]:
                    labels[next_row, next_col] = count
                    stack[top] = next_row * width + next_col
                    top += 1
    return labels, leaves[: count + 1]


@njit
def _joined_outside(
    reachable: Mask, labels: NDArray[np.int32], leaves: NDArray[np.bool_], row0: int, col0: int
) -> bool:
    """Whether all parts that leave the window are joined by ways outside it."""
    height, width = reachable.shape
    window_height, window_width = labels.shape
    seen = np.zeros((height, width), np.bool_)
    queue = np.empty(height * width, np.int64)
    wanted = leaves.copy()
    head, tail = 0, 0
    first = int(np.argmax(leaves))
    for row in range(window_height):
        for col in range(window_width):
            if labels[row, col] == first:
                seen[row0 + row, col0 + col] = True
                queue[tail] = (row0 + row) * width + col0 + col
                tail += 1
    wanted[first] = False
    missing = wanted.sum()
    while head < tail and missing > 0:
        row, col = queue[head] // width, queue[head] % width
        head += 1
        for next_row, next_col in ((row - 1, col), (row + 1, col), (row, col - 1), (row, col + 1)):
            if not (0 <= next_row < height and 0 <= next_col < width) or seen[next_row, next_col]:
                continue
            r, c = next_row - row0, next_col - col0
            if 0 <= r < window_height and 0 <= c < window_width:
                label = labels[r, c]
                if label == 0:
                    continue
                if wanted[label]:
                    wanted[label] = False
                    missing -= 1
            elif not reachable[next_row, next_col]:
                continue
            seen[next_row, next_col] = True
            queue[tail] = next_row * width + next_col
            tail += 1
    return missing == 0
