"""Groups the peaks of belief maps into cuboids by the vector fields, as DOPE does."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rendezvous.geometry.se2 import Array
from rendezvous.pose_estimation.dope_labels import Maps
from rendezvous.pose_estimation.peaks import Peaks

CENTROID = 8
LARGEST_ANGLE_RAD = 0.5
"""Largest angle between a corner's vector and the direction to its centroid; DOPE's value."""
NEAR_CELLS = 1.0
"""Corners closer than this to a centroid may belong to it at any angle: the direction is unreliable there."""
LEAST_CORNERS = 4  # fewest corners that make up a cuboid without a centroid

Indices = NDArray[np.int64]


@dataclass(frozen=True, slots=True, kw_only=True)
class DetectedCuboid:
    """Peaks that belong to one cuboid."""

    uv_cells_92: Array  # (9, 2) in DOPE's order; NaN for a point that was not found
    height_9: Array  # (9,) heights of the peaks; 0 for a point that was not found

    @property
    def score(self) -> float:
        """Mean height over all nine points; may slightly exceed 1."""
        return float(self.height_9.mean())

    @property
    def centre_cells(self) -> Array:
        """(2,) centre of the bounding box of the points."""
        centre: Array = 0.5 * (np.nanmin(self.uv_cells_92, axis=0) + np.nanmax(self.uv_cells_92, axis=0))
        return centre

    @property
    def span_cells(self) -> float:
        """Larger side of that bounding box."""
        return float(np.max(np.nanmax(self.uv_cells_92, axis=0) - np.nanmin(self.uv_cells_92, axis=0)))


def detect_cuboids(peaks: Peaks, fields_Fhw: Maps) -> list[DetectedCuboid]:
    """Cuboids in the maps, by falling score.

    Each corner goes to the nearest centroid that its vector points at; each centroid keeps the highest peak
    of each corner. Corners that point at no centroid form a cuboid of their own if there are enough: a robot
    whose centre is hidden or outside the image.

    Args:
        peaks: peaks of the nine belief maps.
        fields_Fhw: (16, h, w) vector fields.
    """
    centroids = np.flatnonzero(peaks.channel_P == CENTROID)
    corners = np.flatnonzero(peaks.channel_P != CENTROID)
    owner = _owners(peaks, corners, centroids, fields_Fhw)
    found = [_cuboid(peaks, np.append(corners[owner == k], c)) for k, c in enumerate(centroids)]
    orphan = _cuboid(peaks, corners[owner < 0])
    if np.count_nonzero(orphan.height_9) >= LEAST_CORNERS:
        found.append(orphan)
    return sorted(found, key=lambda cuboid: -cuboid.score)


def _owners(peaks: Peaks, corners: Indices, centroids: Indices, fields_Fhw: Maps) -> Indices:
    """(N,) index of the centroid that each corner belongs to; -1 for none."""
    if not len(centroids) or not len(corners):
        return np.full(len(corners), -1)
    uv_N2 = peaks.uv_cells_P2[corners]
    vector_N2 = _vectors(fields_Fhw, peaks.channel_P[corners], uv_N2)
    to_NK2 = peaks.uv_cells_P2[centroids][None] - uv_N2[:, None]
    distance_NK = np.linalg.norm(to_NK2, axis=2)
    along_NK = np.einsum("nkd,nd->nk", to_NK2, vector_N2)
    across_NK = np.abs(to_NK2[..., 0] * vector_N2[:, None, 1] - to_NK2[..., 1] * vector_N2[:, None, 0])
    towards_NK = (along_NK > 0.0) & (np.arctan2(across_NK, along_NK) < LARGEST_ANGLE_RAD)
    distance_NK = np.where(towards_NK | (distance_NK < NEAR_CELLS), distance_NK, np.inf)
    return np.where(np.isfinite(distance_NK.min(axis=1)), distance_NK.argmin(axis=1), -1)


def _vectors(fields_Fhw: Maps, channel_N: Indices, uv_N2: Array) -> Array:
    """(N, 2) unit vectors at corners, averaged over 3x3 cells; zero where the field is zero."""
    height, width = fields_Fhw.shape[1:]
    steps = np.array([(dv, du) for dv in (-1, 0, 1) for du in (-1, 0, 1)])
    col = np.clip(np.rint(uv_N2[:, None, 0]).astype(int) + steps[:, 1], 0, width - 1)
    row = np.clip(np.rint(uv_N2[:, None, 1]).astype(int) + steps[:, 0], 0, height - 1)
    x, y = (fields_Fhw[2 * channel_N[:, None] + axis, row, col].mean(axis=1) for axis in (0, 1))
    vectors = np.stack([x, y], axis=1).astype(np.float64)
    norms = np.linalg.norm(vectors, axis=1, keepdims=True)
    return np.divide(vectors, norms, out=np.zeros_like(vectors), where=norms > 0.0)


def _cuboid(peaks: Peaks, members: Indices) -> DetectedCuboid:
    """The highest of these peaks for each point."""
    uv, height = np.full((9, 2), np.nan), np.zeros(9)
    for peak in members:
        channel = peaks.channel_P[peak]
        if peaks.height_P[peak] > height[channel]:
            uv[channel], height[channel] = peaks.uv_cells_P2[peak], peaks.height_P[peak]
    return DetectedCuboid(uv_cells_92=uv, height_9=height)
