"""Inputs of the pose network with belief maps over them, to look at."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from rendezvous.geometry.camera import Image
from rendezvous.geometry.cuboid import CUBOID_CORNER_SIGNS
from rendezvous.pose_estimation.dope_labels import Maps
from rendezvous.pose_estimation.look import STRIDE_PX
from rendezvous.training.relative_pose.data import PoseSample

_EDGES = [
    (i, j)
    for i in range(8)
    for j in range(i)
    if sum(a != b for a, b in zip(CUBOID_CORNER_SIGNS[i], CUBOID_CORNER_SIGNS[j], strict=True)) == 1
]
_CORNER_RGB, _CENTROID_RGB, _EDGE_RGB = (255, 210, 0), (255, 0, 120), (0, 255, 255)
_ZOOM = 2


def sheet(samples: Sequence[PoseSample], beliefs: Sequence[Maps], *, columns: int) -> Image:
    """(H, W, 3) uint8: the samples row by row.

    Args:
        samples: inputs of one size.
        beliefs: (9, h, w) of each: corners are shown yellow, the centroid red; the true cuboid as thin lines.
        columns: of the sheet.
    """
    panels = [_panel(sample, belief) for sample, belief in zip(samples, beliefs, strict=True)]
    panels += [np.zeros_like(panels[0])] * (-len(panels) % columns)
    rows = [np.concatenate(panels[i : i + columns], axis=1) for i in range(0, len(panels), columns)]
    return np.concatenate(rows)


def _panel(sample: PoseSample, belief_9hw: Maps) -> Image:
    side_px = len(sample.image) * _ZOOM
    image = cv2.resize(sample.image, (side_px, side_px), interpolation=cv2.INTER_LINEAR).astype(np.float32)
    image *= 0.6
    for maps, rgb in ((belief_9hw[:8], _CORNER_RGB), (belief_9hw[8:], _CENTROID_RGB)):
        weight = _enlarged(maps.max(axis=0), side_px)[..., None]
        image += weight * (np.array(rgb, np.float32) - image)
    panel = np.asarray(image.round(), np.uint8)
    if sample.shows_robot:
        points = (_ZOOM * (sample.uv_px + 0.5) - 0.5).round().astype(int).tolist()
        for i, j in _EDGES:
            cv2.line(panel, points[i], points[j], _EDGE_RGB, 1, cv2.LINE_AA)
    panel[:, -1] = panel[-1] = 255
    return panel


def _enlarged(belief_hw: Maps, side_px: int) -> Maps:
    """(side_px, side_px) in [0, 1]: cell (row, col) stands for the input's pixel (row, col) · stride."""
    per_px = STRIDE_PX * _ZOOM
    shift = 0.5 * (_ZOOM - 1)
    matrix = np.array([[per_px, 0.0, shift], [0.0, per_px, shift]])
    large = cv2.warpAffine(belief_hw, matrix, (side_px, side_px), flags=cv2.INTER_LINEAR)
    return np.asarray(np.clip(large, 0.0, 1.0), np.float32)
