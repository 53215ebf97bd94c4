"""The errors of the pose network's belief peaks on the validation looks, and pictures of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
import torch

from rendezvous.geometry.camera import Image
from rendezvous.geometry.cuboid import CUBOID_CORNER_SIGNS
from rendezvous.geometry.se2 import Array
from rendezvous.pose_estimation.dope_labels import Maps
from rendezvous.pose_estimation.look import STRIDE_PX
from rendezvous.pose_estimation.peaks import belief_peaks
from rendezvous.training.batches import evenly_spread, moved
from rendezvous.training.relative_pose.data import PoseSample, pose_batch
from rendezvous.training.relative_pose.model import PoseModel
from rendezvous.training.relative_pose.sampling import PoseSampling

LEAST_HEIGHT = 0.2  # height of a peak that counts as found; the target's is about 1
_AT_ONCE = 32
_SHOWN = 12
_CENTROID = 8
_EDGES = [
    (i, j)
    for i in range(8)
    for j in range(i)
    if sum(a != b for a, b in zip(CUBOID_CORNER_SIGNS[i], CUBOID_CORNER_SIGNS[j], strict=True)) == 1
]
_CORNER_RGB, _CENTROID_RGB, _EDGE_RGB = (255, 210, 0), (255, 0, 120), (0, 255, 255)
_ZOOM = 2


@dataclass(frozen=True, slots=True, kw_only=True)
class PoseValidation:
    """Measures networks on fixed looks."""

    samples: Sequence[PoseSample]
    sampling: PoseSampling
    device: torch.device

    @torch.no_grad()
    def figures(self, model: PoseModel) -> dict[str, float | None]:
        """The errors of a `PosePoint`, in float32."""
        losses, distances_px, false = [], list[Array](), list[bool]()
        for first in range(0, len(self.samples), _AT_ONCE):
            samples = self.samples[first : first + _AT_ONCE]
            batch = moved(pose_batch(samples, self.sampling), self.device)
            losses.append(float(model.loss(batch)[0]) * len(samples))
            for sample, belief in zip(samples, _beliefs(model, samples, self.device), strict=True):
                if sample.close:
                    distances_px.append(self._distances_px(belief, sample))
                elif not sample.shows_robot:
                    found = belief_peaks(belief[_CENTROID:], sigma_cells=self.sampling.belief_sigma_cells)
                    false.append(bool((found.height_P >= LEAST_HEIGHT).any()))
        distances = np.concatenate(distances_px)
        found_px = distances[np.isfinite(distances)]
        return {
            "validation_loss": sum(losses) / len(self.samples),
            "keypoints_found": len(found_px) / max(len(distances), 1),
            "mean_distance_px": float(found_px.mean()) if len(found_px) else None,
            "median_distance_px": float(np.median(found_px)) if len(found_px) else None,
            "false_peaks": float(np.mean(false)) if false else 0.0,
        }

    @torch.no_grad()
    def pictures(self, model: PoseModel) -> dict[str, Image]:
        """The belief maps of some looks, evenly spread."""
        samples = [self.samples[i] for i in evenly_spread(range(len(self.samples)), _SHOWN)]
        beliefs = _beliefs(model, samples, self.device)
        return {"belief_maps": sheet(samples, beliefs, columns=4)}

    def _distances_px(self, belief_9hw: Maps, sample: PoseSample) -> Array:
        """(K,) from each keypoint in the input to its map's highest peak; inf where there is none."""
        peaks = belief_peaks(
            belief_9hw, sigma_cells=self.sampling.belief_sigma_cells, least_height=LEAST_HEIGHT, most=1
        )
        found_px = np.full((9, 2), np.inf)
        found_px[peaks.channel_P] = STRIDE_PX * peaks.uv_cells_P2
        inside = ((sample.uv_px >= 0.0) & (sample.uv_px <= self.sampling.input_px - 1)).all(axis=1)
        distances: Array = np.linalg.norm(found_px - sample.uv_px, axis=1)[inside]
        return distances


def _beliefs(model: PoseModel, samples: Sequence[PoseSample], device: torch.device) -> list[Maps]:
    """(9, h, w) of the last stage, for each sample."""
    images = np.stack([sample.image.transpose(2, 0, 1) for sample in samples])
    maps = model.network(torch.from_numpy(images).to(device))[-1]
    return list(maps.belief_B9hw.float().cpu().numpy())


def sheet(samples: Sequence[PoseSample], beliefs: Sequence[Maps], *, columns: int) -> Image:
    """(H, W, 3) uint8: the samples row by row.

    Corners are yellow, the centroid red, the true cuboid thin lines.
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
