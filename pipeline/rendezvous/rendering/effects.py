"""A camera's effects on a picture: blur, exposure, white balance, noise, compression.

None of them moves anything in the image, so labels stay valid.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from rendezvous.compiled import njit
from rendezvous.errors import require_within
from rendezvous.geometry.camera import Image
from rendezvous.rendering.appearance.colour import blackbody_rgb, linear_from_srgb, srgb_from_linear

Floats = NDArray[np.float32]
Words = NDArray[np.uint32]

WHITE_K = 6504.0
METERED = 0.24  # mean linear brightness targeted by the automatic exposure
MAX_GAIN = 3.0  # the automatic exposure changes brightness by at most this factor, up or down
CODES = 4096  # levels of linear light that the sensor distinguishes before its output is coded as sRGB

_LINEAR: Floats = linear_from_srgb(np.arange(256) / 255.0).astype(np.float32)
_CODED: Image = np.round(255.0 * srgb_from_linear(np.arange(CODES) / (CODES - 1.0))).astype(np.uint8)


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraEffects:
    """Effects on one image; by default automatic exposure alone."""

    exposure_ev: float = 0.0  # stops by which the image is brighter than automatic exposure would make it
    balance_k: float = WHITE_K  # temperature of the light that the camera takes for white [K]
    saturation: float = 1.0  # 0 for grey, 1 for unchanged
    contrast: float = 1.0  # slope of the tone curve about middle grey
    vignetting: float = 0.0  # share of light lost in the image's corners
    shot_noise: float = 0.0  # its standard deviation at full brightness 1; grows with the root of the light
    read_noise: float = 0.0  # standard deviation of noise in darkness, on the same scale
    # motion_blur_px, motion_blur_rad: length and direction of a point's path during exposure.
    motion_blur_px: float = 0.0
    motion_blur_rad: float = 0.0
    defocus_px: float = 0.0  # standard deviation of the blur of a point
    jpeg_quality: int | None = None  # 1 to 100; None for no compression
    noise_seed: int = 0  # seed of the noise's own stream

    def __post_init__(self) -> None:
        noise = (0.0, math.inf)
        require_within(self, vignetting=(0.0, 0.99), shot_noise=noise, read_noise=noise, defocus_px=noise)


def draw_effects(rng: np.random.Generator, *, light_k: float) -> CameraEffects:
    """A camera's settings and flaws.

    Args:
        rng: draws them.
        light_k: temperature of the light in the scene [K]; white balance follows it imperfectly.
    """
    # Normal in mired (1e6 / K), where equal steps look equal, about a mean between the light and daylight.
    mired = 0.6 * 1e6 / light_k + 0.4 * 1e6 / WHITE_K + rng.normal(0.0, 14.0)
    return CameraEffects(
        exposure_ev=float(np.clip(rng.normal(0.0, 0.45), -1.3, 1.3)),
        balance_k=1e6 / float(np.clip(mired, 90.0, 400.0)),
        saturation=float(rng.uniform(0.7, 1.2)),
        contrast=float(rng.uniform(0.85, 1.2)),
        # Zero for a third of images, otherwise uniform.
        vignetting=_some(rng, 0.67, 0.05, 0.4),
        # Log-uniform: sensors and gains differ by factors.
        shot_noise=float(np.exp(rng.uniform(np.log(0.004), np.log(0.05)))),
        read_noise=float(np.exp(rng.uniform(np.log(0.0005), np.log(0.012)))),
        # Both blurs are zero for most images, otherwise uniform.
        motion_blur_px=_some(rng, 0.35, 1.0, 7.0),
        motion_blur_rad=float(rng.uniform(0.0, np.pi)),
        defocus_px=_some(rng, 0.4, 0.3, 1.4),
        jpeg_quality=int(rng.integers(35, 96)) if rng.random() < 0.5 else None,
        noise_seed=int(rng.integers(2**31)),
    )


def _some(rng: np.random.Generator, share: float, low: float, high: float) -> float:
    """Uniform for this share of draws, otherwise 0."""
    value = float(rng.uniform(low, high))
    return value if rng.random() < share else 0.0


def apply_effects(rgb: Image, effects: CameraEffects) -> Image:
    """The sRGB image (H, W, 3) uint8 as the camera delivers it; same size and dtype."""
    linear = cv2.LUT(rgb, _LINEAR)
    if effects.motion_blur_px > 0.0:
        linear = cv2.filter2D(linear, -1, motion_kernel(effects), borderType=cv2.BORDER_REPLICATE)
    if effects.defocus_px > 0.0:
        linear = cv2.GaussianBlur(linear, (0, 0), effects.defocus_px, borderType=cv2.BORDER_REPLICATE)
    gain = exposure_gain(linear, effects) * blackbody_rgb(WHITE_K) / blackbody_rgb(effects.balance_k)
    noise = sensor_noise(effects, rgb.shape[0], rgb.shape[1])
    image = _exposed(
        linear,
        *noise,
        gain.astype(np.float32),
        effects.vignetting,
        np.float32(effects.shot_noise**2),
        np.float32(effects.read_noise**2),
        np.float32(effects.saturation),
        tone_curve(effects.contrast),
    )
    return image if effects.jpeg_quality is None else _compressed(image, effects.jpeg_quality)


def exposure_gain(linear: Floats, effects: CameraEffects) -> float:
    """Factor on linear light (H, W, 3): automatic exposure and its drawn error."""
    # For a mean, every fourth pixel in each direction is enough.
    mean = float(linear[::4, ::4].mean())
    return float(np.clip(METERED / max(mean, 1e-4), 1.0 / MAX_GAIN, MAX_GAIN)) * 2.0**effects.exposure_ev


def motion_kernel(effects: CameraEffects) -> Floats:
    """(N, N) kernel of sum 1, N odd, point-symmetric so that nothing moves."""
    direction = np.array([np.cos(effects.motion_blur_rad), np.sin(effects.motion_blur_rad)])
    reach_px = 0.5 * effects.motion_blur_px * direction
    radius = int(np.ceil(np.abs(reach_px).max()))
    v, u = np.mgrid[-radius : radius + 1, -radius : radius + 1]
    path = np.linspace(-1.0, 1.0, 15)[:, None, None]
    squared = (u - path * reach_px[0]) ** 2 + (v - path * reach_px[1]) ** 2
    # A little wide, so that a slanted path has no gaps.
    kernel = np.exp(-0.5 * squared / 0.4**2).sum(axis=0)
    return (kernel / kernel.sum()).astype(np.float32)


def tone_curve(contrast: float) -> Image:
    """(CODES,) sRGB code of each level of linear light, with contrast changed about middle grey."""
    coded = 128.0 + contrast * (_CODED.astype(np.float64) - 128.0)
    return np.clip(np.round(coded), 0.0, 255.0).astype(np.uint8)


def sensor_noise(effects: CameraEffects, height_px: int, width_px: int) -> tuple[Words, Words]:
    """Random words, each one draw of noise: (H, W) for brightness, (H/2, W/2, 2) for red and blue.

    Colour noise has half the resolution, as after demosaicing.
    """
    rng = np.random.Generator(np.random.SFC64(effects.noise_seed))
    brightness = rng.integers(2**32, size=(height_px, width_px), dtype=np.uint32)
    half = ((height_px + 1) // 2, (width_px + 1) // 2, 2)
    return brightness, rng.integers(2**32, size=half, dtype=np.uint32)


@njit(inline="always")
def normal_of(word: np.uint32) -> np.float32:
    """A roughly standard normal draw within 3.45: the sum of a random word's four bytes.

    Takes a fifth of the time of exact normal draws; the missing tails do not show in pictures.
    """
    total = (word & 255) + ((word >> 8) & 255) + ((word >> 16) & 255) + ((word >> 24) & 255)
    return (np.float32(total) - np.float32(510.0)) * np.float32(1.0 / 147.8)


def _compressed(rgb: Image, quality: int) -> Image:
    ok, data = cv2.imencode(".jpg", rgb[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, quality])
    assert ok
    decoded = cv2.imdecode(data, cv2.IMREAD_COLOR_RGB)
    assert decoded is not None
    return np.asarray(decoded, np.uint8)


@njit(fastmath=True)
def _exposed(
    linear: Floats,
    grey: Words,
    chroma: Words,
    gain: Floats,
    vignetting: float,
    shot_variance: float,
    read_variance: float,
    saturation: float,
    curve: Image,
) -> Image:
    """One pass over the pixels (H, W, 3): gain, vignetting, noise, saturation, coding."""
    height, width, _ = linear.shape
    out = np.empty((height, width, 3), np.uint8)
    centre_v, centre_u = np.float32(0.5 * (height - 1)), np.float32(0.5 * (width - 1))
    fall = np.float32(vignetting) / (centre_v * centre_v + centre_u * centre_u)
    top = np.float32(len(curve) - 1)
    light = np.empty(3, np.float32)
    red, green, blue = np.float32(0.2126), np.float32(0.7152), np.float32(0.0722)
    for v in range(height):
        dv2 = (v - centre_v) * (v - centre_v)
        for u in range(width):
            lens = np.float32(1.0) - fall * (dv2 + (u - centre_u) * (u - centre_u))
            for k in range(3):
                light[k] = linear[v, u, k] * gain[k] * lens
            luma = red * light[0] + green * light[1] + blue * light[2]
            sigma = np.sqrt(shot_variance * luma + read_variance)
            common = normal_of(grey[v, u])
            for k in range(3):
                own = np.float32(0.0) if k == 1 else normal_of(chroma[v // 2, u // 2, k // 2])
                noise = sigma * (common + np.float32(0.6) * own)
                value = luma + saturation * (light[k] - luma) + noise
                code = min(max(value, np.float32(0.0)), np.float32(1.0)) * top
                out[v, u, k] = curve[int(code + np.float32(0.5))]
    return out
