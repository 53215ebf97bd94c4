"""Backgrounds of scenes that are not in a room: procedural rooms out of focus, or the user's photos."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from enum import StrEnum

import cv2
import numpy as np

from rendezvous.geometry.camera import Image
from rendezvous.rendering.appearance.colour import srgb_from_linear
from rendezvous.rendering.appearance.materials import cloth_tint, wall_tint
from rendezvous.rendering.appearance.noise import Field
from rendezvous.rendering.record import JsonValue

SHARPEST_PX, SOFTEST_PX = 1.2, 9.0
"""Range of the blur's standard deviation."""

THINGS, BUSY_THINGS = (2, 9), (20, 60)
"""Numbers of things in a room, the last excluded."""


class BackgroundStyle(StrEnum):
    """What kind of background is wanted."""

    ANY = "any"
    BUSY = "busy"
    WHITE = "white"


def photo_background(rng: np.random.Generator, photo: Image, *, width_px: int, height_px: int) -> Image:
    """A crop of a photo (H, W, 3), scaled to the size; position and scale uniform, mirrored half the time."""
    height, width = photo.shape[:2]
    widest = min(width / width_px, height / height_px)
    scale = widest * rng.uniform(0.6, 1.0)
    cut_w, cut_h = max(int(width_px * scale), 1), max(int(height_px * scale), 1)
    left, top = int(rng.integers(width - cut_w + 1)), int(rng.integers(height - cut_h + 1))
    cut = photo[top : top + cut_h, left : left + cut_w]
    cut = cut[:, ::-1] if rng.random() < 0.5 else cut
    interpolation = cv2.INTER_AREA if scale > 1.0 else cv2.INTER_LINEAR
    return np.asarray(
        cv2.resize(np.ascontiguousarray(cut), (width_px, height_px), interpolation=interpolation)
    )


def room_background(
    rng: np.random.Generator,
    textures: Mapping[str, Image],
    *,
    width_px: int,
    height_px: int,
    busy: bool = False,
) -> Image:
    """A wall, a floor and things in front of the wall, out of focus, painted with textures of the pool.

    A busy one has many things, in focus.
    """
    # Painted at half the size, since all of it is blurred.
    width, height = width_px // 2, height_px // 2
    surfaces = list(textures.values())
    grounds = [image for key, image in textures.items() if not key.startswith("books")]
    horizon = int(height * rng.uniform(0.15, 0.75))
    image = np.empty((height, width, 3), np.float32)
    image[:horizon] = _tint(wall_tint(rng)) * _patch(rng, surfaces, width, horizon, deep=False)
    image[horizon:] = _tint(cloth_tint(rng)) * _patch(rng, grounds, width, height - horizon, deep=True)
    for _ in range(int(rng.integers(*BUSY_THINGS if busy else THINGS))):
        _add_object(rng, image, surfaces, horizon)
    image *= _daylight(rng, width, height)[..., None]
    # Mean brightness uniform.
    image *= np.float32(rng.uniform(0.25, 0.6) / max(float(image.mean()), 0.05))
    # Log-uniform, from slightly soft to mere patches of colour.
    softest_px = 2.0 * SHARPEST_PX if busy else SOFTEST_PX
    sigma_px = float(np.exp(rng.uniform(np.log(SHARPEST_PX), np.log(softest_px))))
    soft = cv2.GaussianBlur(image, (0, 0), 0.5 * sigma_px)
    coded = np.clip(255.0 * soft, 0.0, 255.0).astype(np.uint8)
    return np.asarray(cv2.resize(coded, (width_px, height_px), interpolation=cv2.INTER_LINEAR))


def draw_background(
    rng: np.random.Generator,
    textures: Mapping[str, Image],
    photos: Sequence[Image],
    *,
    width_px: int,
    height_px: int,
    style: BackgroundStyle = BackgroundStyle.ANY,
) -> tuple[Image, Mapping[str, JsonValue]]:
    """A background and its record: style, index of the photo, if there are any, and seed of its draws."""
    seed = int(rng.integers(2**31))
    own = np.random.default_rng(seed)
    if style is BackgroundStyle.WHITE:
        return white_background(own, width_px=width_px, height_px=height_px), {
            "style": style.value,
            "seed": seed,
        }
    if photos:
        index = int(own.integers(len(photos)))
        image = photo_background(own, photos[index], width_px=width_px, height_px=height_px)
        return image, {"style": style.value, "photo": index, "seed": seed}
    busy = style is BackgroundStyle.BUSY
    image = room_background(own, textures, width_px=width_px, height_px=height_px, busy=busy)
    return image, {"style": style.value, "photo": None, "seed": seed}


def white_background(rng: np.random.Generator, *, width_px: int, height_px: int) -> Image:
    """Nearly white paper or a studio's wall, a little darker towards one side."""
    v, u = np.mgrid[:height_px, :width_px].astype(np.float32)
    heading = rng.uniform(-np.pi, np.pi)
    across = (np.cos(heading) * u / width_px + np.sin(heading) * v / height_px).astype(np.float32)
    # Uniform: paper in shade to overexposed.
    value = rng.uniform(0.8, 1.05) + rng.uniform(0.0, 0.12) * across
    tint = np.array([1.0, 1.0, 1.0]) + rng.normal(0.0, 0.01, 3)
    return np.asarray(np.clip(255.0 * value[..., None] * tint, 0.0, 255.0), np.uint8)


def _tint(linear: tuple[float, float, float]) -> Field:
    return srgb_from_linear(np.array(linear)).astype(np.float32)


def _patch(
    rng: np.random.Generator, textures: Sequence[Image], width_px: int, height_px: int, *, deep: bool
) -> Field:
    """(H, W, 3) in [0, 1]: a patch of a texture; deep: receding towards the upper edge."""
    texture = textures[int(rng.integers(len(textures)))]
    v, u = np.mgrid[:height_px, :width_px].astype(np.float32)
    zoom = np.float32(rng.uniform(1.2, 4.0))
    if deep:
        depth = np.float32(height_px) / (v + np.float32(0.06 * height_px))
        u, v = (u - np.float32(0.5 * width_px)) * depth * zoom * np.float32(0.4), 60.0 * depth * zoom
    size = np.float32(len(texture))
    sampled = cv2.remap(
        texture, np.mod(u * zoom, size), np.mod(v * zoom, size), cv2.INTER_LINEAR, borderMode=cv2.BORDER_WRAP
    )
    return (sampled / 255.0).astype(np.float32)


def _add_object(rng: np.random.Generator, image: Field, textures: Sequence[Image], horizon: int) -> None:
    """Paint a cupboard, window, picture or lamp into the image: a rectangle or ellipse of one material."""
    height_px, width_px = image.shape[:2]
    wide, high = int(width_px * rng.uniform(0.05, 0.4)), int(height_px * rng.uniform(0.08, 0.6))
    left = int(rng.integers(-wide // 2, width_px - wide // 2))
    bottom = horizon + int(height_px * rng.uniform(-0.3, 0.2))
    rows = slice(max(bottom - high, 0), min(bottom, height_px))
    cols = slice(max(left, 0), min(left + wide, width_px))
    seen = image[rows, cols]
    if seen.size == 0:
        return
    window = rng.random() < 0.2
    tint = np.full(3, rng.uniform(0.9, 1.3), np.float32) if window else _tint(cloth_tint(rng))
    patch = tint if window else tint * _patch(rng, textures, seen.shape[1], seen.shape[0], deep=False)
    shade = np.linspace(rng.uniform(0.7, 1.1), rng.uniform(0.7, 1.1), seen.shape[1], dtype=np.float32)
    shaded = np.broadcast_to(patch * shade[None, :, None], seen.shape)
    v, u = np.ogrid[rows, cols]
    across, down = (u - left - 0.5 * wide) / (0.5 * wide), (v - bottom + 0.5 * high) / (0.5 * high)
    inside = across**2 + down**2 < 1.0 if rng.random() < 0.25 else np.full(seen.shape[:2], True)
    seen[inside] = shaded[inside]


def _daylight(rng: np.random.Generator, width_px: int, height_px: int) -> Field:
    """(H, W) brightness that falls off from a point, like a lamp or window."""
    v, u = np.mgrid[:height_px, :width_px].astype(np.float32)
    at_u, at_v = rng.uniform(0.0, width_px), rng.uniform(-0.3, 0.6) * height_px
    away = np.hypot(u - at_u, v - at_v) / width_px
    return (rng.uniform(0.45, 0.8) + rng.uniform(0.2, 0.7) * np.exp(-3.0 * away)).astype(np.float32)
