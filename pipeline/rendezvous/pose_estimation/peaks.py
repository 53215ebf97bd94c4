"""Sub-cell peaks of belief maps."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rendezvous.compiled import njit
from rendezvous.geometry.se2 import Array
from rendezvous.pose_estimation.dope_labels import Maps

LEAST_HEIGHT = 0.05  # peaks below this are noise
MOST_PER_CHANNEL = 4
_REACH_CELLS = 2
_WIDTH = 0.7
"""Width of the kernel around a peak, in standard deviations of the target: narrow enough to ignore that
targets are cut off at two of them, wide enough to average noise."""
_STEPS = 4


@dataclass(frozen=True, slots=True, kw_only=True)
class Peaks:
    """Maxima of a stack of maps, by rising channel, the highest of each map first."""

    channel_P: NDArray[np.int64]  # (P,) index of the map
    uv_cells_P2: Array  # (P, 2) column and row, sub-cell
    height_P: Array  # (P,) height of the best-fitting Gaussian of the target's width; 1 for the target itself


def belief_peaks(
    belief_Chw: Maps,
    *,
    sigma_cells: float,
    least_height: float = LEAST_HEIGHT,
    most: int = MOST_PER_CHANNEL,
) -> Peaks:
    """The maxima of each map.

    A peak's position is the fixed point m of a weighted mean of cells near a local maximum, the weights being
    belief times a Gaussian kernel around m. This is exact for a Gaussian of any width, and symmetric noise
    does not bias it.

    Args:
        belief_Chw: (C, h, w).
        sigma_cells: standard deviation of the target's Gaussians.
        least_height: height below which maxima are dropped.
        most: largest number of peaks per map.
    """
    found = _maxima(belief_Chw, sigma_cells, _WIDTH * sigma_cells, least_height)
    found = found[np.lexsort([-found[:, 3], found[:, 0]])]
    channel_P = found[:, 0].astype(np.int64)
    first_of_channel = np.searchsorted(channel_P, channel_P)
    kept = np.arange(len(found)) - first_of_channel < most
    return Peaks(channel_P=channel_P[kept], uv_cells_P2=found[kept, 1:3], height_P=found[kept, 3])


@njit
def _maxima(belief_Chw, sigma, kernel, least_height):  # type: ignore[no-untyped-def]
    """(P, 4) float64: channel, column, row, height."""
    channels, height, width = belief_Chw.shape
    found = []
    for channel in range(channels):
        belief = belief_Chw[channel]
        for row in range(height):
            for col in range(width):
                if belief[row, col] >= least_height and _is_maximum(belief, row, col):
                    u, v, fitted = _fit(belief, row, col, sigma, kernel)
                    if fitted >= least_height:
                        found.append((float(channel), u, v, fitted))
    out = np.empty((len(found), 4))
    for i in range(len(found)):
        out[i] = found[i]
    return out


@njit
def _is_maximum(belief, row, col):  # type: ignore[no-untyped-def]
    """Whether the cell is the maximum of its 3x3 neighbourhood; the first of equal ones is."""
    height, width = belief.shape
    for y in range(max(row - 1, 0), min(row + 2, height)):
        for x in range(max(col - 1, 0), min(col + 2, width)):
            before = y < row or (y == row and x < col)
            other = belief[y, x]
            if other > belief[row, col] or (before and other == belief[row, col]):
                return False
    return True


@njit
def _fit(belief, row, col, sigma, kernel):  # type: ignore[no-untyped-def]
    """Sub-cell column, row and height of the maximum at a cell."""
    height, width = belief.shape
    u, v, fitted = float(col), float(row), 0.0
    # For a target of width sigma the weighted mean covers only 1 / gain of the way.
    gain = 1.0 + (sigma / kernel) ** 2
    for _ in range(_STEPS):
        total = moved_u = moved_v = shape = 0.0
        for y in range(max(row - _REACH_CELLS, 0), min(row + _REACH_CELLS + 1, height)):
            for x in range(max(col - _REACH_CELLS, 0), min(col + _REACH_CELLS + 1, width)):
                squared = (x - u) ** 2 + (y - v) ** 2
                near = np.exp(-0.5 * squared / kernel**2)
                weight = near * max(belief[y, x], 0.0)
                total += weight
                moved_u += weight * (x - u)
                moved_v += weight * (y - v)
                shape += near * np.exp(-0.5 * squared / sigma**2)
        if total <= 0.0:
            break
        fitted = total / shape
        du, dv = gain * moved_u / total, gain * moved_v / total
        # A maximum lies in or near its cell; on a slope the step would run away.
        u = min(max(u + du, col - 0.75), col + 0.75)
        v = min(max(v + dv, row - 0.75), row + 0.75)
    return u, v, fitted
