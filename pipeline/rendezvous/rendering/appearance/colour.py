"""Colour: sRGB's transfer curve, the colour of black bodies, and palettes of things in rooms."""

from __future__ import annotations

import numpy as np

from rendezvous.geometry.se2 import Array
from rendezvous.rendering.appearance.noise import Field

# Linear sRGB of CIE XYZ (IEC 61966-2-1).
_RGB_OF_XYZ: Array = np.array(
    [[3.2406, -1.5372, -0.4986], [-0.9689, 1.8758, 0.0415], [0.0557, -0.2040, 1.0570]]
)
LUMINANCE: Array = np.array([0.2126, 0.7152, 0.0722])  # weights of linear red, green and blue in luminance


def linear_from_srgb(coded: Array) -> Array:
    """Linear light of sRGB values, both in [0, 1]."""
    return np.where(coded <= 0.04045, coded / 12.92, ((coded + 0.055) / 1.055) ** 2.4)


def srgb_from_linear(linear: Array) -> Array:
    """Inverse of `linear_from_srgb`."""
    return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1.0 / 2.4) - 0.055)


def blackbody_rgb(temperature_k: float) -> Array:
    """(3,) linear sRGB, of luminance 1, of a black body at 1667 to 25000 K; 6504 K is about white.

    Source: Kim et al., US patent 7024034: cubic splines of the Planckian locus.
    """
    t = 1e3 / temperature_k
    if temperature_k <= 4000.0:
        x = -0.2661239 * t**3 - 0.2343589 * t**2 + 0.8776956 * t + 0.179910
    else:
        x = -3.0258469 * t**3 + 2.1070379 * t**2 + 0.2226347 * t + 0.240390
    if temperature_k <= 2222.0:
        y = -1.1063814 * x**3 - 1.34811020 * x**2 + 2.18555832 * x - 0.20219683
    elif temperature_k <= 4000.0:
        y = -0.9549476 * x**3 - 1.37418593 * x**2 + 2.09137015 * x - 0.16748867
    else:
        y = 3.0817580 * x**3 - 5.87338670 * x**2 + 3.75112997 * x - 0.37001483
    rgb = np.maximum(_RGB_OF_XYZ @ np.array([x / y, 1.0, (1.0 - x - y) / y]), 0.0)
    unit: Array = rgb / (LUMINANCE @ rgb)
    return unit


Palette = tuple[tuple[int, int, int], ...]

WOODS: Palette = (
    (190, 150, 104),
    (112, 76, 48),
    (212, 178, 130),
    (146, 88, 56),
    (160, 148, 134),
    (74, 54, 44),
)
STONES: Palette = (
    (206, 200, 190),
    (176, 172, 166),
    (222, 218, 210),
    (120, 118, 116),
    (198, 180, 156),
    (84, 88, 92),
)
BRICKS: Palette = ((156, 82, 62), (176, 104, 76), (132, 70, 58), (200, 180, 158), (150, 140, 132))
BINDINGS: Palette = (
    (122, 44, 38),
    (44, 58, 92),
    (52, 84, 62),
    (196, 180, 150),
    (62, 58, 56),
    (168, 120, 58),
    (222, 220, 212),
    (90, 62, 44),
    (70, 110, 130),
    (186, 76, 48),
)


def pick_colour(rng: np.random.Generator, palette: Palette) -> Field:
    """(3,) uniform from the palette; brightness normal with 7 %, each channel with another 1.5 %."""
    colour = np.array(palette[rng.integers(len(palette))], np.float32) / 255.0
    scale = rng.normal(1.0, 0.07) * rng.normal(1.0, 0.015, size=3)
    return np.clip(colour * scale.astype(np.float32), 0.02, 0.98)
