"""A map drawn on another grid without losing a wall."""

from __future__ import annotations

import math

import numpy as np

from rendezvous.compiled import njit
from rendezvous.geometry.occupancy_grid import OCCUPIED, UNKNOWN, Cells
from rendezvous.geometry.se2 import Array


@njit
def resampled(
    source: Cells, T_s_g: Array, source_m: float, cell_m: float, corner_m: float, shape: tuple[int, int]
) -> Cells:
    """(H, W) uint8: the source's cells on another grid g.

    Each cell takes the source cell that its centre lies in, unknown outside. A turned wall of one cell can
    slip between all centres, so every occupied source cell also marks the cell that its own centre lies in.

    Args:
        source: cells of a map.
        T_s_g: (3,) pose of frame g in the frame s of the source's outer corner: x [m], y [m], yaw [rad].
        source_m: side of a source cell [m].
        cell_m: side of a cell of g [m].
        corner_m: x and y in g of the outer corner of its cell (0, 0) [m].
        shape: H and W.
    """
    (height, width), (rows, cols) = source.shape, shape
    c, s = math.cos(T_s_g[2]), math.sin(T_s_g[2])
    out = np.full(shape, UNKNOWN, np.uint8)
    # Cell to source cell: col_s = x0 + ux * col - uy * row, row_s = y0 + uy * col + ux * row.
    ux, uy = c * cell_m / source_m, s * cell_m / source_m
    first_m = 0.5 * cell_m + corner_m
    x0 = (T_s_g[0] + (c - s) * first_m) / source_m
    y0 = (T_s_g[1] + (s + c) * first_m) / source_m
    for row in range(rows):
        for col in range(cols):
            col_s = math.floor(x0 + ux * col - uy * row)
            row_s = math.floor(y0 + uy * col + ux * row)
            if 0 <= row_s < height and 0 <= col_s < width:
                out[row, col] = source[row_s, col_s]
    for row_s in range(height):
        for col_s in range(width):
            if source[row_s, col_s] == OCCUPIED:
                x_m = (col_s + 0.5) * source_m - T_s_g[0]
                y_m = (row_s + 0.5) * source_m - T_s_g[1]
                col = math.floor((c * x_m + s * y_m - corner_m) / cell_m)
                row = math.floor((c * y_m - s * x_m - corner_m) / cell_m)
                if 0 <= row < rows and 0 <= col < cols:
                    out[row, col] = OCCUPIED
    return out
