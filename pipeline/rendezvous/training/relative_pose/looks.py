"""Where looks at an image are drawn: wide ones, close ones, and ones that miss the robot.

`uv_px` (9, 2) [px] are the points of the robot's cuboid in the image, NaN where there is none.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from rendezvous.geometry.se2 import Array
from rendezvous.pose_estimation.look import Look
from rendezvous.training.relative_pose.sampling import PoseSampling

_TRIES = 20
_MARGIN = 0.1
"""Distance that a look elsewhere keeps from the cuboid's points, as a share of the robot's span."""


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
