"""Materials of walls, floors, furniture and small things, drawn at random.

Colours are drawn in sRGB, where equal steps look equal, and stored as linear light.
"""

from __future__ import annotations

import colorsys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from rendezvous.floorplan.records import Shape, Solid
from rendezvous.geometry.se2 import Array
from rendezvous.rendering.appearance.colour import WOODS, linear_from_srgb
from rendezvous.rendering.appearance.textures import KINDS, texture_key
from rendezvous.rendering.scene import Material, Rgb

Draw = Callable[[np.random.Generator, int], Material]
"""Draws a material; the int is the texture pool's number of variants of each kind."""

WHITE: Rgb = (1.0, 1.0, 1.0)
LEG_M = 0.06  # cylinders up to this radius are legs


def linear_rgb(srgb: Sequence[float] | Array) -> Rgb:
    """Linear light of an sRGB colour, each channel in [0, 1]."""
    red, green, blue = linear_from_srgb(np.clip(np.asarray(srgb, np.float64), 0.0, 1.0)).tolist()
    return red, green, blue


def _hued(rng: np.random.Generator, saturation: tuple[float, float], value: tuple[float, float]) -> Rgb:
    """Hue, saturation and value uniform."""
    return linear_rgb(colorsys.hsv_to_rgb(rng.random(), rng.uniform(*saturation), rng.uniform(*value)))


def grey(value: float, warmth: float = 0.0) -> Rgb:
    """Linear light of an sRGB grey of this value; warmth moves it from blue to red."""
    return linear_rgb((value + warmth, value, value - warmth))


def wall_tint(rng: np.random.Generator) -> Rgb:
    """Near white, more often warm than cold, for three walls in four; pastel or strong for the others."""
    if rng.random() < 0.75:
        value, warmth = rng.uniform(0.78, 0.97), rng.normal(0.015, 0.025)
        return linear_rgb((value + warmth, value, value - 1.5 * warmth))
    return _hued(rng, (0.1, 0.45), (0.45, 0.92))


def cloth_tint(rng: np.random.Generator) -> Rgb:
    """Grey or beige for half of all cloth, a muted colour for the rest."""
    if rng.random() < 0.5:
        return grey(rng.uniform(0.15, 0.85), rng.uniform(-0.01, 0.05))
    return _hued(rng, (0.2, 0.65), (0.2, 0.7))


def _untinted(rng: np.random.Generator) -> Rgb:
    """Grey of 0.8 to 1 sRGB."""
    return grey(rng.uniform(0.8, 1.0))


def _concrete_tint(rng: np.random.Generator) -> Rgb:
    """Grey, hardly coloured."""
    return grey(rng.uniform(0.5, 0.95), rng.normal(0.0, 0.015))


def _textured(kind: str, tint: Callable[[np.random.Generator], Rgb], roughness: tuple[float, float]) -> Draw:
    """Draws materials with a kind of texture; roughness and size of a repeat are uniform."""

    def draw(rng: np.random.Generator, variants: int) -> Material:
        return Material(
            base_colour_rgb=tint(rng),
            roughness=rng.uniform(*roughness),
            texture=texture_key(kind, int(rng.integers(variants))),
            texture_scale_m=rng.uniform(*KINDS[kind].side_m),
        )

    return draw


def _one_of(*choices: tuple[float, Draw]) -> Draw:
    """Draws a material by one of the choices, with probability proportional to its weight."""
    weights = np.array([weight for weight, _ in choices])

    def draw(rng: np.random.Generator, variants: int) -> Material:
        return choices[rng.choice(len(choices), p=weights / weights.sum())][1](rng, variants)

    return draw


def metal(rng: np.random.Generator, variants: int) -> Material:
    """Brushed or bare steel and aluminium, a quarter of it black."""
    value = rng.uniform(0.12, 0.25) if rng.random() < 0.25 else rng.uniform(0.5, 0.85)
    brushed = rng.random() < 0.5
    return Material(
        base_colour_rgb=grey(value),
        metallic=rng.uniform(0.6, 1.0),
        roughness=rng.uniform(0.25, 0.6),
        texture=texture_key("brushed", int(rng.integers(variants))) if brushed else None,
        texture_scale_m=rng.uniform(*KINDS["brushed"].side_m),
    )


def painted(rng: np.random.Generator, variants: int) -> Material:
    """Lacquer: half of it white, the rest brown like wood or a muted colour."""
    style = rng.choice(3, p=[0.5, 0.15, 0.35])
    if style == 0:
        rgb = _untinted(rng)
    elif style == 1:
        rgb = linear_rgb(np.array(WOODS[rng.integers(len(WOODS))]) / 255.0)
    else:
        rgb = _hued(rng, (0.1, 0.6), (0.2, 0.85))
    return Material(base_colour_rgb=rgb, roughness=rng.uniform(0.2, 0.6))


def plastic(rng: np.random.Generator, variants: int) -> Material:
    """Any colour, often black, grey or white."""
    value = rng.random()
    rgb = _hued(rng, (0.4, 0.95), (0.3, 0.95)) if rng.random() < 0.6 else grey(value)
    return Material(base_colour_rgb=rgb, roughness=rng.uniform(0.2, 0.7))


def ceramic(rng: np.random.Generator, variants: int) -> Material:
    """White and smooth."""
    value = rng.uniform(0.85, 0.97)
    return Material(base_colour_rgb=linear_rgb((value, value, value - 0.02)), roughness=rng.uniform(0.1, 0.3))


def leaf(rng: np.random.Generator, variants: int) -> Material:
    """Green leaves."""
    rgb = colorsys.hsv_to_rgb(rng.uniform(0.22, 0.4), rng.uniform(0.35, 0.75), rng.uniform(0.2, 0.55))
    return Material(
        base_colour_rgb=linear_rgb(rgb),
        roughness=rng.uniform(0.5, 0.9),
        texture=texture_key("carpet", int(rng.integers(variants))),
        texture_scale_m=1.0,
    )


wood = _textured("wood", _untinted, (0.3, 0.75))
fabric = _textured("fabric", cloth_tint, (0.8, 1.0))
cardboard = _textured("cardboard", _untinted, (0.75, 0.95))
books = _textured("books", lambda _: WHITE, (0.6, 0.9))
marble = _textured("marble", _untinted, (0.1, 0.5))
paint = _textured("paint", wall_tint, (0.6, 0.95))

floor_material = _one_of(
    (0.24, _textured("planks", _untinted, (0.3, 0.75))),
    (0.14, _textured("parquet", _untinted, (0.3, 0.7))),
    (0.18, _textured("tiles", _untinted, (0.15, 0.6))),
    (0.16, _textured("carpet", cloth_tint, (0.9, 1.0))),
    (0.10, _textured("concrete", _concrete_tint, (0.4, 0.9))),
    (0.08, _textured("terrazzo", _untinted, (0.2, 0.6))),
    (0.05, _textured("marble", _untinted, (0.1, 0.4))),
    (0.05, _textured("ornament", _untinted, (0.8, 1.0))),
)
wall_material = _one_of(
    (0.58, paint),
    (0.16, _textured("plaster", wall_tint, (0.8, 1.0))),
    (0.08, _textured("stripes", _untinted, (0.7, 0.95))),
    (0.06, _textured("brick", _untinted, (0.8, 1.0))),
    (0.05, _textured("concrete", _concrete_tint, (0.6, 0.95))),
    (0.04, _textured("tiles", _untinted, (0.15, 0.5))),
    (0.03, _textured("ornament", _untinted, (0.7, 0.95))),
)
anything_material = _one_of((0.3, wood), (0.25, painted), (0.2, plastic), (0.15, metal), (0.1, fabric))
_pot = _one_of((0.5, plastic), (0.3, ceramic), (0.2, painted))
_FURNITURE: Mapping[str, Draw] = {
    "table": _one_of((0.65, wood), (0.25, painted), (0.1, marble)),
    "desk": _one_of((0.6, wood), (0.4, painted)),
    "chair": _one_of((0.5, wood), (0.2, painted), (0.3, plastic)),
    "armchair": _one_of((0.8, fabric), (0.2, plastic)),
    "sofa": _one_of((0.85, fabric), (0.15, plastic)),
    "bed": _one_of((0.9, fabric), (0.1, painted)),
    "wardrobe": _one_of((0.55, wood), (0.45, painted)),
    "shelf": _one_of((0.6, books), (0.25, wood), (0.15, painted)),
    "drawers": _one_of((0.6, wood), (0.4, painted)),
    "counter": _one_of((0.3, wood), (0.5, painted), (0.2, marble)),
    "appliance": _one_of((0.6, ceramic), (0.4, metal)),
    "bathtub": _one_of((1.0, ceramic)),
    "toilet": _one_of((1.0, ceramic)),
    "washbasin": _one_of((1.0, ceramic)),
    "radiator": _one_of((0.8, ceramic), (0.2, metal)),
    "rack": _one_of((0.8, metal), (0.2, painted)),
    "bench": _one_of((0.7, wood), (0.3, metal)),
    "boxes": _one_of((0.85, cardboard), (0.15, plastic)),
    "pole": _one_of((0.7, metal), (0.3, painted)),
    "bin": _one_of((0.6, plastic), (0.4, metal)),
    "screen": _one_of((0.5, fabric), (0.5, painted)),
}


def ceiling_material(rng: np.random.Generator, variants: int) -> Material:
    """White paint."""
    return Material(
        base_colour_rgb=grey(rng.uniform(0.88, 0.98)),
        roughness=0.95,
        texture=texture_key("paint", int(rng.integers(variants))),
        texture_scale_m=2.0,
    )


def any_texture_material(rng: np.random.Generator, variants: int) -> Material:
    """Any texture in any colour, for images that need not look plausible."""
    kind = list(KINDS)[rng.integers(len(KINDS))]
    return Material(
        base_colour_rgb=_hued(rng, (0.0, 0.7), (0.4, 1.0)),
        metallic=float(rng.choice([0.0, rng.uniform(0.0, 1.0)], p=[0.8, 0.2])),
        roughness=rng.uniform(0.1, 1.0),
        texture=texture_key(kind, int(rng.integers(variants))),
        texture_scale_m=rng.uniform(*KINDS[kind].side_m),
    )


def piece_materials(
    rng: np.random.Generator, furniture: Sequence[Solid], *, variants: int
) -> Mapping[int, tuple[Material, Material]]:
    """Materials of each piece of furniture, by its index: of its body, and of parts that are `is_second`."""
    category_of = {solid.item: solid.category for solid in furniture}
    return {item: _body_and_legs(rng, category, variants) for item, category in sorted(category_of.items())}


def _body_and_legs(rng: np.random.Generator, category: str, variants: int) -> tuple[Material, Material]:
    if category == "plant":
        return _pot(rng, variants), leaf(rng, variants)
    body = _FURNITURE.get(category, anything_material)(rng, variants)
    if category in ("bed", "armchair", "sofa") or rng.random() < 0.5:
        return body, wood(rng, variants)
    return body, metal(rng, variants) if rng.random() < 0.6 else body


def is_second(solid: Solid) -> bool:
    """Whether a part of a piece of furniture is a leg, a headboard or leaves."""
    if solid.category == "plant":
        return solid.z0_m > 0.0
    if solid.category == "bed":
        return solid.half_y_m < 0.1 or solid.z1_m - solid.z0_m >= 0.99
    return solid.category != "pole" and solid.shape is Shape.CYLINDER and solid.half_x_m <= LEG_M


def worn(rng: np.random.Generator, material: Material, *, extent: float) -> Material:
    """A robot's part as it may look on another robot of the same make, or an older one.

    Args:
        rng: draws the wear.
        material: as built.
        extent: at 1, brightness stays within about 40 %, hue within 15 %, roughness and metallic within 0.15.
    """
    # Log-normal brightness and channel gains, both clipped at two standard deviations.
    gain = np.exp(np.clip(rng.normal(0.0, 0.17, 1), -0.34, 0.34) * extent)
    hue = np.exp(np.clip(rng.normal(0.0, 0.07, 3), -0.14, 0.14) * extent)
    # Dust makes black plastic grey: uniform.
    dust = rng.uniform(0.0, 0.02) * extent
    red, green, blue = np.clip(np.array(material.base_colour_rgb) * gain * hue + dust, 0.0, 1.0).tolist()
    shift = rng.uniform(-0.15, 0.15, 2) * extent
    return replace(
        material,
        base_colour_rgb=(red, green, blue),
        metallic=float(np.clip(material.metallic + shift[0] * (material.metallic > 0.0), 0.0, 1.0)),
        roughness=float(np.clip(material.roughness + shift[1], 0.08, 1.0)),
    )
