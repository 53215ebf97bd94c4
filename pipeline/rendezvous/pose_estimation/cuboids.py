"""Peaks of belief maps to cuboids: which corners are of which centroid, by the vector fields, as in DOPE."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rendezvous.geometry.se2 import Array
from rendezvous.pose_estimation.dope_labels import Maps
from rendezvous.pose_estimation.peaks import Peaks

CENTROID = 8
LARGEST_ANGLE_RAD = 0.5
"""Between a corner's vector and the direction to its centroid, as in DOPE."""
NEAR_CELLS = 1.0
"""A corner so near to a centroid may be its own at any angle: the direction is not told well."""
LEAST_CORNERS = 4
"""For a cuboid whose centroid was not found."""


@dataclass(frozen=True, slots=True, kw_only=True)
class DetectedCuboid:
    """Peaks that belong together.

    Attributes:
        uv_cells_92: (9, 2) in DOPE's order; NaN for a point that was not found.
        height_9: (9,) of the peaks; 0 for a point that was not found.
    """

    uv_cells_92: Array
    height_9: Array

    @property
    def score(self) -> float:
        """Mean height over all nine points, in [0, 1] or little above."""
        return float(self.height_9.mean())

    @property
    def centre_cells(self) -> Array:
        """(2,) the middle of the box around the points."""
        centre: Array = 0.5 * (np.nanmin(self.uv_cells_92, axis=0) + np.nanmax(self.uv_cells_92, axis=0))
        return centre

    @property
    def span_cells(self) -> float:
        """The larger side of that box."""
        return float(np.max(np.nanmax(self.uv_cells_92, axis=0) - np.nanmin(self.uv_cells_92, axis=0)))


def detect_cuboids(peaks: Peaks, fields_Fhw: Maps) -> list[DetectedCuboid]:
    """Cuboids in the maps, the one with the most belief first.

    Every corner goes to the centroid that its vector points to, of several to the nearest; every centroid
    takes the highest of the peaks of a kind that come to it. Corners that point to no centroid make up a
    cuboid of their own if there are enough: a robot whose middle is hidden or out of sight.

    Args:
        peaks: of the nine belief maps.
        fields_Fhw: (16, h, w) vector fields.
    """
    centroids = np.flatnonzero(peaks.channel_P == CENTROID)
    corners = np.flatnonzero(peaks.channel_P != CENTROID)
    owner = _owners(peaks, corners, centroids, fields_Fhw)
    found = [_cuboid(peaks, corners[owner == k], c) for k, c in enumerate(centroids.tolist())]
    alone = _cuboid(peaks, corners[owner < 0], None)
    if np.count_nonzero(alone.height_9) >= LEAST_CORNERS:
        found.append(alone)
    return sorted(found, key=lambda cuboid: -cuboid.score)


def _owners(peaks: Peaks, corners: np.ndarray, centroids: np.ndarray, fields_Fhw: Maps) -> np.ndarray:
    """(N,) which centroid each corner belongs to; -1 for none."""
    if not len(centroids) or not len(corners):
        return np.full(len(corners), -1)
    uv_N2 = peaks.uv_cells_P2[corners]
    vector_N2 = _vectors(fields_Fhw, peaks.channel_P[corners], uv_N2)
    to_NK2 = peaks.uv_cells_P2[centroids][None] - uv_N2[:, None]
    distance_NK = np.linalg.norm(to_NK2, axis=2)
    along_NK = np.einsum("nkd,nd->nk", to_NK2, vector_N2)
    across_NK = np.abs(to_NK2[..., 0] * vector_N2[:, None, 1] - to_NK2[..., 1] * vector_N2[:, None, 0])
    towards_NK = (along_NK > 0.0) & (np.arctan2(across_NK, along_NK) < LARGEST_ANGLE_RAD)
    fits = towards_NK | (distance_NK < NEAR_CELLS)
    distance_NK = np.where(fits, distance_NK, np.inf)
    nearest = distance_NK.argmin(axis=1)
    return np.where(np.isfinite(distance_NK.min(axis=1)), nearest, -1)


def _vectors(fields_Fhw: Maps, channel_N: np.ndarray, uv_N2: Array) -> Array:
    """(N, 2) unit vectors at corners, the mean of the 3x3 cells around; zero where the field says nothing."""
    height, width = fields_Fhw.shape[1:]
    steps = np.array([(dv, du) for dv in (-1, 0, 1) for du in (-1, 0, 1)])
    col = np.clip(np.rint(uv_N2[:, None, 0]).astype(int) + steps[:, 1], 0, width - 1)
    row = np.clip(np.rint(uv_N2[:, None, 1]).astype(int) + steps[:, 0], 0, height - 1)
    x, y = (fields_Fhw[2 * channel_N[:, None] + axis, row, col].mean(axis=1) for axis in (0, 1))
    vectors = np.stack([x, y], axis=1).astype(np.float64)
    norms = np.linalg.norm(vectors, axis=1, keepdims=True)
    return np.divide(vectors, norms, out=np.zeros_like(vectors), where=norms > 0.0)


def _cuboid(peaks: Peaks, corners: np.ndarray, centroid: int | None) -> DetectedCuboid:
    uv, height = np.full((9, 2), np.nan), np.zeros(9)
    for peak in [*corners.tolist(), *([] if centroid is None else [centroid])]:
        channel = peaks.channel_P[peak]
        if peaks.height_P[peak] > height[channel]:
            uv[channel], height[channel] = peaks.uv_cells_P2[peak], peaks.height_P[peak]
    return DetectedCuboid(uv_cells_92=uv, height_9=height)
