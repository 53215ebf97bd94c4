"""Augmentation of the pose network's inputs: colours, blur, noise, compression, patches that hide parts.

Nothing is moved, so labels stay true; a mirrored image would be of another robot.
"""

from __future__ import annotations

import cv2
import numpy as np

from rendezvous.geometry.camera import Image
from rendezvous.geometry.se2 import Array
from rendezvous.training.relative_pose.sampling import ImageAugmentation

_ANYWHERE = 0.3
"""Share of patches that lie anywhere rather than on the robot."""


def augmented_image(
    image: Image, box_px: Array, parameters: ImageAugmentation, rng: np.random.Generator
) -> Image:
    """The augmented input (H, W, 3) uint8; same size.

    Patches may hide parts of the box (2, 2), its lowest and highest u, v.
    """
    if rng.random() < parameters.patch_share:
        image = _with_patches(image, box_px, parameters, rng)
    if rng.random() < parameters.blur_share:
        image = np.asarray(
            cv2.GaussianBlur(image, (0, 0), rng.uniform(0.3, 0.3 + parameters.blur_px)), np.uint8
        )
    if rng.random() < parameters.grey_share:
        grey = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
        image = np.asarray(cv2.cvtColor(grey, cv2.COLOR_GRAY2RGB), np.uint8)
    image = np.asarray(cv2.LUT(image, _tone_curves(parameters, rng)), np.uint8)
    if rng.random() < parameters.noise_share:
        image = _noisy(image, 255.0 * rng.uniform(0.0, parameters.noise), rng)
    if rng.random() < parameters.jpeg_share:
        image = _compressed(image, int(rng.integers(parameters.least_jpeg_quality, 101)))
    return image


def _tone_curves(parameters: ImageAugmentation, rng: np.random.Generator) -> Image:
    """(1, 256, 3) codes by channel: gamma and gains log-uniform, the offset uniform."""
    codes = np.linspace(0.0, 1.0, 256)
    gamma = np.exp(rng.uniform(-1.0, 1.0) * np.log1p(parameters.gamma))
    gains = np.exp(rng.uniform(-1.0, 1.0) * np.log1p(parameters.gain) * rng.uniform(0.5, 1.0, 3))
    curves = gains * codes[:, None] ** gamma + rng.uniform(-parameters.offset, parameters.offset)
    return np.asarray(np.clip(255.0 * curves, 0.0, 255.0).round(), np.uint8)[None]


def _noisy(image: Image, sigma: float, rng: np.random.Generator) -> Image:
    """Normal noise on each channel."""
    noise = rng.standard_normal(image.shape, np.float32)
    noise *= np.float32(sigma)
    noise += image
    return np.asarray(np.clip(noise, 0.0, 255.0, out=noise), np.uint8)


def _compressed(image: Image, quality: int) -> Image:
    _, data = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, quality])
    return np.asarray(cv2.imdecode(data, cv2.IMREAD_COLOR), np.uint8)


def _with_patches(
    image: Image, box_px: Array, parameters: ImageAugmentation, rng: np.random.Generator
) -> Image:
    """Rectangles of uniform colour, their sides a uniform share of the box's; most on the box."""
    image = image.copy()
    height, width = image.shape[:2]
    span_px = float((box_px[1] - box_px[0]).max())
    for _ in range(int(rng.integers(1, parameters.patches + 1))):
        size = span_px * rng.uniform(0.1, max(parameters.patch_size, 0.1), 2)
        low, high = (np.zeros(2), np.array([width, height])) if rng.random() < _ANYWHERE else box_px
        u0, v0 = (rng.uniform(low, high) - 0.5 * size).round().astype(int)
        u1, v1 = (np.array([u0, v0]) + size.round()).astype(int)
        image[max(v0, 0) : max(v1, 0), max(u0, 0) : max(u1, 0)] = rng.integers(0, 256, 3)
    return image
