"""Seamless procedural textures of the materials in rooms.

A texture is (S, S, 3) uint8, sRGB, and tiles in both directions. `KINDS` lists what can be made; a pool holds
several variants of each kind, keyed `kind-000`, `kind-001`, ...
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from rendezvous.geometry.camera import Image
from rendezvous.rendering.appearance import surfaces
from rendezvous.rendering.appearance.noise import Field


@dataclass(frozen=True, slots=True, kw_only=True)
class TextureKind:
    """How textures of a kind are made, and how much surface one covers."""

    # Makes (S, S, 3) sRGB in [0, 1] from an rng and the side S [px].
    make: Callable[[np.random.Generator, int], Field]
    side_m: tuple[float, float]  # smallest and largest side of the square that one repeat covers
    neutral: bool = False  # whether it is light grey, to be tinted by a material's colour


def texture_key(kind: str, variant: int) -> str:
    """Key of a texture in a pool."""
    return f"{kind}-{variant:03d}"


def texture_pool(rng: np.random.Generator, *, variants: int, size_px: int = 512) -> Mapping[str, Image]:
    """Textures of every kind by key; each has its own stream, spawned in the order of `KINDS`."""
    streams = iter(rng.spawn(len(KINDS) * variants))
    pool = {}
    for name, kind in KINDS.items():
        for variant in range(variants):
            colour = kind.make(next(streams), size_px)
            pool[texture_key(name, variant)] = np.clip(colour * 255.0 + 0.5, 0.0, 255.0).astype(np.uint8)
    return pool


KINDS: Mapping[str, TextureKind] = {
    "planks": TextureKind(make=surfaces.planks, side_m=(0.6, 1.4)),
    "parquet": TextureKind(make=surfaces.parquet, side_m=(0.8, 1.8)),
    "wood": TextureKind(make=surfaces.plain_wood, side_m=(0.5, 1.2)),
    "tiles": TextureKind(make=surfaces.tiles, side_m=(0.5, 1.4)),
    "brick": TextureKind(make=surfaces.brick, side_m=(0.7, 1.0)),
    "carpet": TextureKind(make=surfaces.carpet, side_m=(0.3, 0.8), neutral=True),
    "fabric": TextureKind(make=surfaces.fabric, side_m=(0.15, 0.4), neutral=True),
    "concrete": TextureKind(make=surfaces.concrete, side_m=(1.0, 2.5), neutral=True),
    "plaster": TextureKind(make=surfaces.plaster, side_m=(0.4, 1.2), neutral=True),
    "paint": TextureKind(make=surfaces.paint, side_m=(0.8, 2.0), neutral=True),
    "marble": TextureKind(make=surfaces.marble, side_m=(0.8, 2.0)),
    "terrazzo": TextureKind(make=surfaces.terrazzo, side_m=(0.4, 1.0)),
    "cardboard": TextureKind(make=surfaces.cardboard, side_m=(0.4, 0.8)),
    "stripes": TextureKind(make=surfaces.stripes, side_m=(0.5, 1.2)),
    "ornament": TextureKind(make=surfaces.ornament, side_m=(0.6, 1.6)),
    "brushed": TextureKind(make=surfaces.brushed, side_m=(0.3, 0.8), neutral=True),
    "books": TextureKind(make=surfaces.books, side_m=(1.1, 1.5)),
}
