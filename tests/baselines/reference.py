"""The scores of all shifts at one heading by Fourier transform: the formula, without any bound."""

from __future__ import annotations

import numpy as np
from scipy.signal import fftconvolve

from rendezvous.alignment.window import OCCUPIED_CELL, MapWindow
from rendezvous.baselines.correlation import likelihood_field
from rendezvous.geometry.se2 import Array


def reference_scores(
    window: MapWindow, yaw_rad: float, reach: int, *, blur_cells: float, free_penalty: float
) -> Array:
    """(2 reach + 1, 2 reach + 1): `Σ wall_0(u) field_1(R (u + s)) + Σ field_0(u) wall_1(R (u + s))`."""
    field_0, field_1 = (
        likelihood_field(cells, blur_cells=blur_cells, free_penalty=free_penalty) for cells in window.cells
    )
    size = len(field_0)
    c, s = np.cos(yaw_rad), np.sin(yaw_rad)
    row, col = np.mgrid[-reach : size + reach, -reach : size + reach]
    x, y = col + 0.5 - size / 2, row + 0.5 - size / 2
    col_1 = np.floor(size / 2 + c * x - s * y).astype(int)
    row_1 = np.floor(size / 2 + s * x + c * y).astype(int)
    inside = (col_1 >= 0) & (col_1 < size) & (row_1 >= 0) & (row_1 < size)
    turned_1 = np.where(inside, field_1[row_1.clip(0, size - 1), col_1.clip(0, size - 1)], 0)
    walls_1 = np.zeros((size + 2 * reach, size + 2 * reach))
    x, y = (np.argwhere(window.cells[1] == OCCUPIED_CELL)[:, ::-1] + (0.5 - size / 2)).T
    col_0 = np.floor(size / 2 + c * x + s * y).astype(int) + reach
    row_0 = np.floor(size / 2 - s * x + c * y).astype(int) + reach
    inside = (col_0 >= 0) & (col_0 < size + 2 * reach) & (row_0 >= 0) & (row_0 < size + 2 * reach)
    walls_1[row_0[inside], col_0[inside]] = 1
    walls_0 = (window.cells[0] == OCCUPIED_CELL).astype(float)
    scores = _correlated(turned_1, walls_0) + _correlated(walls_1, field_0)
    return np.rint(scores).astype(np.int64)


def _correlated(larger: Array, smaller: Array) -> Array:
    return fftconvolve(larger, smaller[::-1, ::-1], mode="valid")
