"""Batches for training and validating the pose network, drawn from looks at images of the robot.

Looks are wide, close, or miss the robot. `uv_px` (9, 2) [px] are the points of its cuboid in the image, NaN
where there is none. Legend: B sample, 3 red green blue, H W rows and columns of the input, h w of the maps, 9
belief maps, 16 vector fields.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TypedDict

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from rendezvous.errors import StoreError
from rendezvous.geometry.camera import Image
from rendezvous.geometry.se2 import Array
from rendezvous.pose_estimation.dope_labels import Maps, belief_maps, vector_fields
from rendezvous.pose_estimation.look import STRIDE_PX, Look
from rendezvous.seeds import stream
from rendezvous.training.batches import EpochOrder, NumberedBatches, evenly_spread
from rendezvous.training.relative_pose.poses import PoseImage, PoseTable
from rendezvous.training.relative_pose.sampling import PoseSampling, augmented_image

_TRIES = 20
_MARGIN = 0.1  # distance that a look elsewhere keeps from the cuboid's points, as a share of the robot's span


def span_px(uv_px: Array) -> float:
    """Larger side of the box around the points (N, 2)."""
    return float(np.ptp(uv_px, axis=0).max())


def draw_wide_look(
    size_px: tuple[int, int], uv_px: Array, sampling: PoseSampling, rng: np.random.Generator
) -> Look:
    """A look with the centroid anywhere but little beyond the image: uniform; the span is log-uniform."""
    bounds_px = np.log([sampling.least_span_px, sampling.greatest_span_px])
    scale = float(np.exp(rng.uniform(*bounds_px))) / span_px(uv_px)
    place = rng.uniform(-0.5, sampling.input_px - 0.5, 2)
    return _kept_on(_look(uv_px[8], place, scale, sampling), size_px)


def draw_close_look(uv_px: Array, sampling: PoseSampling, rng: np.random.Generator) -> Look:
    """A look with the robot's box in the middle, at the span for measuring; both with normal errors."""
    middle = 0.5 * (uv_px[:8].min(axis=0) + uv_px[:8].max(axis=0))
    place = 0.5 * (sampling.input_px - 1) + rng.normal(0.0, sampling.close_jitter_px, 2)
    scale = sampling.close_span_px / span_px(uv_px)
    return _look(middle, place, scale * float(np.exp(rng.normal(0.0, sampling.close_jitter_log))), sampling)


def draw_look_elsewhere(
    size_px: tuple[int, int], uv_px: Array, sampling: PoseSampling, rng: np.random.Generator
) -> Look | None:
    """A look around a uniform place of the image that misses the robot; its scale is log-uniform.

    Every other one stays on the image as far as possible.

    None where the robot leaves hardly any room for one.
    """
    margin_px = _MARGIN * span_px(uv_px)
    low, high = uv_px.min(axis=0) - margin_px, uv_px.max(axis=0) + margin_px
    for _ in range(_TRIES):
        scale = float(np.exp(rng.uniform(*np.log([sampling.least_scale, sampling.greatest_scale]))))
        centre = rng.uniform(-0.5, np.array(size_px) - 0.5)
        look = _look(centre, np.full(2, 0.5 * (sampling.input_px - 1)), scale, sampling)
        look = _kept_on(look, size_px) if rng.random() < 0.5 else look
        seen_low, seen_high = look.to_image(np.array([[-0.5, -0.5], [sampling.input_px - 0.5] * 2]))
        if not ((low < seen_high) & (seen_low < high)).all():
            return look
    return None


def _kept_on(look: Look, size_px: tuple[int, int]) -> Look:
    """The look moved so that it shows nothing beyond the image, or the whole image if that is smaller."""
    # At these the first or the last pixels of both have their outer edges in one place.
    first = 0.5 * look.scale - 0.5
    last = first + np.array([look.width_px, look.height_px]) - look.scale * np.array(size_px)
    u, v = np.clip(look.offset_px, np.minimum(first, last), np.maximum(first, last)).tolist()
    return replace(look, offset_px=(u, v))


def _look(point_px: Array, place_px: Array, scale: float, sampling: PoseSampling) -> Look:
    """The look that shows a point of the image at a place of the input, its scale within the bounds."""
    scale = float(np.clip(scale, sampling.least_scale, sampling.greatest_scale))
    u, v = place_px - scale * point_px
    side_px = sampling.input_px
    return Look(scale=scale, offset_px=(float(u), float(v)), width_px=side_px, height_px=side_px)


class PoseBatch(TypedDict):
    """Samples side by side."""

    image_B3HW: Tensor  # uint8
    # belief_B9hw, fields_B16hw: float32 of `dope_labels`.
    belief_B9hw: Tensor
    fields_B16hw: Tensor


@dataclass(frozen=True, slots=True, kw_only=True)
class PoseSample:
    """One input."""

    image: Image
    uv_px: Array  # (9, 2) the cuboid's points in the input; NaN in an input without the robot
    close: bool

    @property
    def shows_robot(self) -> bool:
        """Whether the network is to find the robot in it."""
        return bool(np.isfinite(self.uv_px).all())


class _Looker:
    """Draws looks at the images of a split."""

    def __init__(self, poses: PoseTable, sampling: PoseSampling) -> None:
        self.poses, self.sampling = poses, sampling
        self.showing = poses.showing(least_visibility=sampling.least_visibility)
        self.without = poses.without_robot()
        if not self.showing:
            raise StoreError(
                f"poses/{poses.split}: none of {len(poses)} images shows at least "
                f"{sampling.least_visibility:g} of the robot; training needs some"
            )

    def at_robot(self, row: int, rng: np.random.Generator, *, close: bool) -> PoseSample:
        """A look that shows the row's robot."""
        pose = self.poses[row]
        if close:
            look = draw_close_look(pose.uv_px, self.sampling, rng)
        else:
            look = draw_wide_look(_size_px(pose), pose.uv_px, self.sampling, rng)
        return PoseSample(image=look.cut(pose.image), uv_px=look.to_input(pose.uv_px), close=close)

    def elsewhere(self, row: int, rng: np.random.Generator) -> PoseSample | None:
        """A look at the row's image without the robot; None if the robot leaves no room for one."""
        pose = self.poses[row]
        seen = pose.uv_px if pose.visibility > 0.0 else np.full((9, 2), np.nan)
        look = draw_look_elsewhere(_size_px(pose), seen, self.sampling, rng)
        if look is None:
            return None
        return PoseSample(image=look.cut(pose.image), uv_px=np.full((9, 2), np.nan), close=False)


class PoseTrainingBatches(NumberedBatches[PoseSample, PoseBatch]):
    """Batches for training, drawn in permutations of the images that show the robot."""

    def __init__(self, poses: PoseTable, sampling: PoseSampling, *, seed: int, **shares: int) -> None:
        super().__init__(seed=seed, **shares)
        self.sampling = sampling
        self._looker = _Looker(poses, sampling)
        plausible = [row for row in self._looker.showing if poses.plausible[row]]
        free = [row for row in self._looker.showing if not poses.plausible[row]]
        self._rows = plausible or free, free or plausible
        self._orders = [EpochOrder(len(rows), seed=seed) for rows in self._rows]

    def sample(self, number: int) -> PoseSample:
        """One augmented look."""
        rng = stream(self.seed, "train", number)
        kind = 0 if rng.random() < self.sampling.plausible_share else 1
        sample = self._look(self._rows[kind][self._orders[kind].row(number)], rng)
        image = augmented_image(sample.image, _box_px(sample), self.sampling.augmentation, rng)
        return PoseSample(image=image, uv_px=sample.uv_px, close=sample.close)

    def batch(self, samples: list[PoseSample]) -> PoseBatch:
        return pose_batch(samples, self.sampling)

    def _look(self, row: int, rng: np.random.Generator) -> PoseSample:
        if rng.random() < self.sampling.absent_share:
            without = self._looker.without
            # Half of them of images without the robot: few images, but all of their places may be seen.
            if without and rng.random() < 0.5:
                elsewhere = self._looker.elsewhere(without[int(rng.integers(len(without)))], rng)
            else:
                elsewhere = self._looker.elsewhere(row, rng)
            if elsewhere is not None:
                return elsewhere
        return self._looker.at_robot(row, rng, close=rng.random() < self.sampling.close_share)


def validation_samples(
    poses: PoseTable, sampling: PoseSampling, *, seed: int, count: int
) -> list[PoseSample]:
    """Looks at images as they are, evenly spread over the split: at each a close, a wide one and one
    elsewhere.
    """
    looker = _Looker(poses, sampling)
    samples = list[PoseSample]()
    for row in evenly_spread(looker.showing, count):
        rng = stream(seed, "validation", row)
        samples += [looker.at_robot(row, rng, close=close) for close in (True, False)]
        elsewhere = looker.elsewhere(row, rng)
        samples += [elsewhere] if elsewhere is not None else []
    return samples


def pose_batch(samples: Sequence[PoseSample], sampling: PoseSampling) -> PoseBatch:
    """Samples with the maps that a network shall give of them."""
    images: NDArray[np.uint8] = np.stack([sample.image.transpose(2, 0, 1) for sample in samples])
    maps = [target_maps(sample.uv_px, sampling) for sample in samples]
    return PoseBatch(
        image_B3HW=torch.from_numpy(images),
        belief_B9hw=torch.from_numpy(np.stack([belief for belief, _ in maps])),
        fields_B16hw=torch.from_numpy(np.stack([field for _, field in maps])),
    )


def target_maps(uv_px: Array, sampling: PoseSampling) -> tuple[Maps, Maps]:
    """(9, h, w) belief maps and (16, h, w) vector fields of one robot, from its points (9, 2) [px] or NaN.

    A point near the border has its peak cut off there, unlike in `belief_maps`, which leaves it out: the
    robot is to be found at the edge of an image as well. Points beyond the input have none.
    """
    side_px, reach = sampling.input_px, int(2.0 * sampling.belief_sigma_cells)
    inside = np.all((uv_px >= -0.5) & (uv_px < side_px - 0.5), axis=1, keepdims=True)
    frame_px = reach * STRIDE_PX
    framed = belief_maps(
        np.where(inside, uv_px + frame_px, np.nan)[None],
        width_px=side_px + 2 * frame_px,
        height_px=side_px + 2 * frame_px,
        stride_px=STRIDE_PX,
        sigma_cells=sampling.belief_sigma_cells,
    )
    fields = vector_fields(
        uv_px[None],
        width_px=side_px,
        height_px=side_px,
        stride_px=STRIDE_PX,
        radius_cells=sampling.field_radius_cells,
    )
    cells = side_px // STRIDE_PX
    return np.ascontiguousarray(framed[:, reach : reach + cells, reach : reach + cells]), fields


def _size_px(pose: PoseImage) -> tuple[int, int]:
    height, width = pose.image.shape[:2]
    return width, height


def _box_px(sample: PoseSample) -> Array:
    """(2, 2) box that patches may hide parts of: the robot, or the middle of an input without it."""
    side_px = len(sample.image)
    if not sample.shows_robot:
        return np.array([[0.25 * side_px] * 2, [0.75 * side_px] * 2])
    return np.array([sample.uv_px.min(axis=0), sample.uv_px.max(axis=0)])
