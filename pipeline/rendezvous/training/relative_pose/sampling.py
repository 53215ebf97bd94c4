"""Parameters of the pose network's samples, and the augmentation of its inputs: colours, blur, noise,
compression, patches that hide parts. Nothing is moved, so labels stay true.

Imports no PyTorch: the configuration is read without it.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import cv2
import numpy as np

from rendezvous.errors import ConfigError, require_within
from rendezvous.geometry.camera import Image
from rendezvous.geometry.se2 import Array
from rendezvous.pose_estimation.look import STRIDE_PX

_ANYWHERE = 0.3  # share of patches that lie anywhere rather than on the robot


@dataclass(frozen=True, slots=True, kw_only=True)
class ImageAugmentation:
    """Augmentation of an input, beyond the variation of the rendering itself."""

    gain: float = 0.2  # each colour channel's gain is within a factor of 1 plus this
    offset: float = 0.1  # of all channels, within ± this share of full brightness
    gamma: float = 0.3  # of all channels, within a factor of 1 plus this
    grey_share: float = 0.05  # share of inputs that lose their colours
    # blur_share, blur_px: share of blurred inputs, and the largest standard deviation.
    blur_share: float = 0.25
    blur_px: float = 1.2
    # noise_share, noise: share of noisy inputs, and the largest standard deviation, of full brightness 1.
    noise_share: float = 0.3
    noise: float = 0.05
    # jpeg_share, least_jpeg_quality: share of compressed inputs, and the lowest quality.
    jpeg_share: float = 0.25
    least_jpeg_quality: int = 30
    # patch_share, patches: share of inputs with patches that hide parts, and their largest number.
    patch_share: float = 0.35
    patches: int = 3
    patch_size: float = 0.4  # largest side of a patch, as a share of the robot's span

    def __post_init__(self) -> None:
        shares = dict.fromkeys(("grey_share", "blur_share", "noise_share", "jpeg_share"), (0.0, 1.0))
        require_within(
            self,
            **shares,
            patch_share=(0.0, 1.0),
            gain=(0.0, 4.0),
            offset=(0.0, 1.0),
            gamma=(0.0, 4.0),
            blur_px=(0.0, 10.0),
            noise=(0.0, 1.0),
            least_jpeg_quality=(1, 100),
            patches=(1, 100),
            patch_size=(0.0, 1.0),
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class PoseSampling:
    """Inputs of the pose network, and their labels.

    A wide look shows the robot anywhere in the input and as little as possible beyond the image's edges, as
    the search for it does; a close look shows it in the middle at the size at which its keypoints are
    measured.
    """

    input_px: int = 160  # side of the square input, a multiple of 8
    belief_sigma_cells: float = 1.0  # standard deviation of a belief map's peak
    field_radius_cells: int = 2  # radius of a vector field's disc
    # Share of looks at images as another robot takes them; the others show the robot at any attitude before
    # any background. Robots only meet upright ones, and the heading is learnt last.
    plausible_share: float = 0.85
    least_visibility: float = 0.2  # of a labelled robot; images that show less of it, but some, are left out
    # least_span_px, greatest_span_px: larger side of the robot's projected cuboid in wide looks; log-uniform.
    least_span_px: float = 10.0
    greatest_span_px: float = 140.0
    # least_scale, greatest_scale: of a look: input pixels per image pixel, whatever the span would be.
    least_scale: float = 0.25
    greatest_scale: float = 3.0
    close_share: float = 0.7  # share of close ones among looks with the robot
    close_span_px: float = 100.0  # larger side of its projected cuboid there
    # close_jitter_px, close_jitter_log: standard deviations of its place and of the logarithm of its size
    # there; normal.
    close_jitter_px: float = 10.0
    close_jitter_log: float = 0.2
    # Share of looks without the robot: at an image without it, or elsewhere in one with it.
    absent_share: float = 0.2
    augmentation: ImageAugmentation = field(default_factory=ImageAugmentation)  # of the input

    def __post_init__(self) -> None:
        require_within(
            self,
            input_px=(4 * STRIDE_PX, 4096),
            belief_sigma_cells=(0.3, 10.0),
            field_radius_cells=(0, 20),
            plausible_share=(0.0, 1.0),
            least_visibility=(0.0, 1.0),
            least_span_px=(1.0, self.greatest_span_px),
            greatest_span_px=(1.0, self.input_px),
            least_scale=(0.01, self.greatest_scale),
            greatest_scale=(0.01, 100.0),
            close_share=(0.0, 1.0),
            close_span_px=(1.0, self.input_px),
            close_jitter_px=(0.0, self.input_px),
            close_jitter_log=(0.0, 2.0),
            absent_share=(0.0, 0.95),
        )
        if self.input_px % STRIDE_PX:
            raise ConfigError(f"PoseSampling: input_px is {self.input_px}; must be a multiple of {STRIDE_PX}")


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
