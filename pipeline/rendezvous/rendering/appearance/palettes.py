"""sRGB colours of things in rooms."""

from __future__ import annotations

import numpy as np

from rendezvous.rendering.appearance.noise import Field

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
