"""The evidence that peaks of belief maps give about the cuboid's points: one density over the image per map.

A network trained on squared errors learns the mean of its targets: the point's probability, blurred with the
target's Gaussian. So a map with several peaks means that the point is near one of them, each with a
probability equal to the peak's height, or anywhere else. A low, wide peak of an uncertain network leaves the
point a variance s² with height = σ² / (σ² + s²).

Legend: G belief maps (nine per look), J peaks of a map, M states of an `ObservationModel`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rendezvous.errors import require_within
from rendezvous.geometry.se2 import Array
from rendezvous.pose_estimation.look import STRIDE_PX, Look
from rendezvous.pose_estimation.peaks import MOST_PER_CHANNEL, Peaks

_SUREST = 0.98  # upper limit on the total probability of a map's peaks: a network sometimes errs


@dataclass(frozen=True, slots=True, kw_only=True)
class KeypointNoise:
    """Accuracy of peaks."""

    floor_cells: float = 0.1  # standard deviation of a peak of full height, along each axis
    scale: float = 0.3  # factor on the variance inferred from a peak's height

    def __post_init__(self) -> None:
        require_within(self, floor_cells=(0.001, 10.0), scale=(0.0, 100.0))


@dataclass(frozen=True, slots=True, kw_only=True)
class KeypointEvidence:
    """Densities of points in an image."""

    channel_G: NDArray[np.int64]  # (G,) index of the point that each map shows
    uv_px_GJ2: Array  # (G, J, 2) peaks in the image; 0 beyond a map's last peak
    variance_px2_GJ: Array  # (G, J) variance of the point around each peak, along each axis
    weight_GJ: Array  # (G, J) probability of each peak; 0 beyond a map's last peak
    elsewhere_G: Array  # (G,) density of the point away from all peaks [1 / px²]
    cell_px: float  # side of the maps' cells in the image
    power: float  # exponent of each map's likelihood: 1 / number of looks, since all see the same robot

    def log_densities(self, uv_M92: Array, *, added_px2: float = 0.0) -> tuple[Array, Array]:
        """(M, G) log of each map's density at the points, and (M, G, J) share of each peak in that density.

        Args:
            uv_M92: (M, 9, 2) the cuboid's points in the image.
            added_px2: variance added to every peak, so that it attracts from farther away.
        """
        variance = self.variance_px2_GJ + added_px2
        away = uv_M92[:, self.channel_G, None] - self.uv_px_GJ2
        near = self.weight_GJ / (2.0 * np.pi * variance) * np.exp(-0.5 * (away**2).sum(axis=3) / variance)
        total = near.sum(axis=2) + self.elsewhere_G
        return np.log(total), near / total[..., None]

    def log_likelihood(self, uv_M92: Array, *, added_px2: float = 0.0) -> Array:
        """(M,) log likelihood ratio of all maps to an image without a robot; see `log_densities`."""
        gain: Array = self.log_densities(uv_M92, added_px2=added_px2)[0] - np.log(self.elsewhere_G)
        return self.power * gain.sum(axis=1)


def evidence_of(
    found: Sequence[tuple[Look, Peaks]], *, sigma_cells: float, noise: KeypointNoise
) -> KeypointEvidence:
    """The joint evidence of one or more looks at the same robot.

    Args:
        found: each look and the peaks of its nine maps, at most `MOST_PER_CHANNEL` per map.
        sigma_cells: standard deviation of the target's Gaussians.
        noise: accuracy of peaks.
    """
    maps = 9 * len(found)
    uv, height = np.zeros((maps, MOST_PER_CHANNEL, 2)), np.zeros((maps, MOST_PER_CHANNEL))
    px_per_cell, area_px2 = np.ones(maps), np.ones(maps)
    for number, (look, peaks) in enumerate(found):
        first = np.searchsorted(peaks.channel_P, peaks.channel_P)
        place = 9 * number + peaks.channel_P, np.arange(len(first)) - first
        uv[place] = look.to_image(STRIDE_PX * peaks.uv_cells_P2)
        height[place] = peaks.height_P
        own = slice(9 * number, 9 * number + 9)
        px_per_cell[own] = STRIDE_PX / look.scale
        area_px2[own] = look.width_px * look.height_px / look.scale**2
    total = height.sum(axis=1)
    weight = _SUREST * height / np.maximum(total, 1.0)[:, None]
    blur = sigma_cells**2 * (1.0 / np.clip(total, 0.01, 1.0) - 1.0)
    variance = px_per_cell**2 * (noise.floor_cells**2 + noise.scale * blur)
    return KeypointEvidence(
        channel_G=np.tile(np.arange(9), len(found)),
        uv_px_GJ2=uv,
        variance_px2_GJ=np.repeat(variance[:, None], MOST_PER_CHANNEL, axis=1),
        weight_GJ=weight,
        elsewhere_G=(1.0 - weight.sum(axis=1)) / area_px2,
        cell_px=float(px_per_cell.mean()),
        power=1.0 / len(found),
    )
