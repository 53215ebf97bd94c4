"""What walls, floors, furniture and things are made of, drawn at random.

Colours are drawn in sRGB, where equal steps look equal, and kept linear, as light adds up.
"""

from __future__ import annotations

import colorsys
from collections.abc import Callable, Mapping, Sequence

import numpy as np

from rendezvous.floorplan.records import Shape, Solid
from rendezvous.geometry.se2 import Array
from rendezvous.rendering.appearance.colour import linear_from_srgb
from rendezvous.rendering.appearance.palettes import WOODS
from rendezvous.rendering.appearance.textures import KINDS, texture_key
from rendezvous.rendering.scene import Material, Rgb

Draw = Callable[[np.random.Generator, int], Material]
"""A material from an rng and the number of variants that the texture pool has of each kind."""

WHITE: Rgb = (1.0, 1.0, 1.0)
LEG_M = 0.06
"""Poles up to this radius are legs."""


def linear_rgb(srgb: Sequence[float] | Array) -> Rgb:
    """Linear colour of an sRGB one, each channel in [0, 1]."""
    red, green, blue = linear_from_srgb(np.clip(np.asarray(srgb, np.float64), 0.0, 1.0)).tolist()
    return red, green, blue


def _hued(rng: np.random.Generator, saturation: tuple[float, float], value: tuple[float, float]) -> Rgb:
    """Hue, saturation and value uniform."""
    return linear_rgb(colorsys.hsv_to_rgb(rng.random(), rng.uniform(*saturation), rng.uniform(*value)))


def wall_tint(rng: np.random.Generator) -> Rgb:
    """Near white for three walls in four, warm more often than cold; pastel or strong for the others."""
    if rng.random() < 0.75:
        value, warmth = rng.uniform(0.78, 0.97), rng.normal(0.015, 0.025)
        return linear_rgb((value + warmth, value, value - 1.5 * warmth))
    return _hued(rng, (0.1, 0.45), (0.45, 0.92))


def cloth_tint(rng: np.random.Generator) -> Rgb:
    """Greys and beiges for half of the cloths, muted colours for the others."""
    if rng.random() < 0.5:
        value, warmth = rng.uniform(0.15, 0.85), rng.uniform(-0.01, 0.05)
        return linear_rgb((value + warmth, value, value - warmth))
    return _hued(rng, (0.2, 0.65), (0.2, 0.7))


def _textured(kind: str, tint: Callable[[np.random.Generator], Rgb], roughness: tuple[float, float]) -> Draw:
    """Of one texture kind; roughness and size of a repeat uniform."""

    def draw(rng: np.random.Generator, variants: int) -> Material:
        return Material(
            base_colour_rgb=tint(rng),
            roughness=rng.uniform(*roughness),
            texture=texture_key(kind, int(rng.integers(variants))),
            texture_scale_m=rng.uniform(*KINDS[kind].side_m),
        )

    return draw


def _untinted(rng: np.random.Generator) -> Rgb:
    """Grey of 0.8 to 1 sRGB."""
    value = rng.uniform(0.8, 1.0)
    return linear_rgb((value, value, value))


def _grey(rng: np.random.Generator) -> Rgb:
    """Concrete and metal: grey, hardly coloured."""
    value, warmth = rng.uniform(0.5, 0.95), rng.normal(0.0, 0.015)
    return linear_rgb((value + warmth, value, value - warmth))


def metal(rng: np.random.Generator, variants: int) -> Material:
    """Brushed or bare steel and aluminium, some of it black."""
    value = rng.uniform(0.12, 0.25) if rng.random() < 0.25 else rng.uniform(0.5, 0.85)
    brushed = rng.random() < 0.5
    return Material(
        base_colour_rgb=linear_rgb((value, value, value)),
        metallic=rng.uniform(0.6, 1.0),
        roughness=rng.uniform(0.25, 0.6),
        texture=texture_key("brushed", int(rng.integers(variants))) if brushed else None,
        texture_scale_m=rng.uniform(*KINDS["brushed"].side_m),
    )


def painted(rng: np.random.Generator, variants: int) -> Material:
    """Lacquer: white for half, wood-brown or a muted colour for the others."""
    style = rng.choice(3, p=[0.5, 0.15, 0.35])
    if style == 0:
        rgb = _untinted(rng)
    elif style == 1:
        rgb = linear_rgb(np.array(WOODS[rng.integers(len(WOODS))]) / 255.0)
    else:
        rgb = _hued(rng, (0.1, 0.6), (0.2, 0.85))
    return Material(base_colour_rgb=rgb, roughness=rng.uniform(0.2, 0.6))


def plastic(rng: np.random.Generator, variants: int) -> Material:
    """Any colour, black and white more often."""
    value = rng.random()
    rgb = _hued(rng, (0.4, 0.95), (0.3, 0.95)) if rng.random() < 0.6 else linear_rgb((value, value, value))
    return Material(base_colour_rgb=rgb, roughness=rng.uniform(0.2, 0.7))


def ceramic(rng: np.random.Generator, variants: int) -> Material:
    """White and smooth."""
    value = rng.uniform(0.85, 0.97)
    return Material(base_colour_rgb=linear_rgb((value, value, value - 0.02)), roughness=rng.uniform(0.1, 0.3))


def leaf(rng: np.random.Generator, variants: int) -> Material:
    """Green of plants."""
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

_FLOORS: tuple[tuple[float, Draw], ...] = (
    (0.24, _textured("planks", _untinted, (0.3, 0.75))),
    (0.14, _textured("parquet", _untinted, (0.3, 0.7))),
    (0.18, _textured("tiles", _untinted, (0.15, 0.6))),
    (0.16, _textured("carpet", cloth_tint, (0.9, 1.0))),
    (0.10, _textured("concrete", _grey, (0.4, 0.9))),
    (0.08, _textured("terrazzo", _untinted, (0.2, 0.6))),
    (0.05, _textured("marble", _untinted, (0.1, 0.4))),
    (0.05, _textured("ornament", _untinted, (0.8, 1.0))),
)
_WALLS: tuple[tuple[float, Draw], ...] = (
    (0.58, paint),
    (0.16, _textured("plaster", wall_tint, (0.8, 1.0))),
    (0.08, _textured("stripes", _untinted, (0.7, 0.95))),
    (0.06, _textured("brick", _untinted, (0.8, 1.0))),
    (0.05, _textured("concrete", _grey, (0.6, 0.95))),
    (0.04, _textured("tiles", _untinted, (0.15, 0.5))),
    (0.03, _textured("ornament", _untinted, (0.7, 0.95))),
)
_ANYTHING: tuple[tuple[float, Draw], ...] = (
    (0.3, wood), (0.25, painted), (0.2, plastic), (0.15, metal), (0.1, fabric),
)  # fmt: skip
_FURNITURE: Mapping[str, tuple[tuple[float, Draw], ...]] = {
    "table": ((0.65, wood), (0.25, painted), (0.1, marble)),
    "desk": ((0.6, wood), (0.4, painted)),
    "chair": ((0.5, wood), (0.2, painted), (0.3, plastic)),
    "armchair": ((0.8, fabric), (0.2, plastic)),
    "sofa": ((0.85, fabric), (0.15, plastic)),
    "bed": ((0.9, fabric), (0.1, painted)),
    "wardrobe": ((0.55, wood), (0.45, painted)),
    "shelf": ((0.6, books), (0.25, wood), (0.15, painted)),
    "drawers": ((0.6, wood), (0.4, painted)),
    "counter": ((0.3, wood), (0.5, painted), (0.2, marble)),
    "appliance": ((0.6, ceramic), (0.4, metal)),
    "bathtub": ((1.0, ceramic),),
    "toilet": ((1.0, ceramic),),
    "washbasin": ((1.0, ceramic),),
    "radiator": ((0.8, ceramic), (0.2, metal)),
    "rack": ((0.8, metal), (0.2, painted)),
    "bench": ((0.7, wood), (0.3, metal)),
    "boxes": ((0.85, cardboard), (0.15, plastic)),
    "pole": ((0.7, metal), (0.3, painted)),
    "bin": ((0.6, plastic), (0.4, metal)),
    "screen": ((0.5, fabric), (0.5, painted)),
}


def _drawn_of(rng: np.random.Generator, choices: tuple[tuple[float, Draw], ...], variants: int) -> Material:
    weights = np.array([weight for weight, _ in choices])
    return choices[rng.choice(len(choices), p=weights / weights.sum())][1](rng, variants)


def floor_material(rng: np.random.Generator, variants: int) -> Material:
    """What one walks on."""
    return _drawn_of(rng, _FLOORS, variants)


def wall_material(rng: np.random.Generator, variants: int) -> Material:
    """Paint, mostly."""
    return _drawn_of(rng, _WALLS, variants)


def ceiling_material(rng: np.random.Generator, variants: int) -> Material:
    """White paint."""
    value = rng.uniform(0.88, 0.98)
    return Material(
        base_colour_rgb=linear_rgb((value, value, value)),
        roughness=0.95,
        texture=texture_key("paint", int(rng.integers(variants))),
        texture_scale_m=2.0,
    )


def anything_material(rng: np.random.Generator, variants: int) -> Material:
    """For things that may be made of anything."""
    return _drawn_of(rng, _ANYTHING, variants)


def any_texture_material(rng: np.random.Generator, variants: int) -> Material:
    """Any texture in any colour: for images that need not look plausible."""
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
    """By index of the piece of furniture: its body's material, and that of what `is_second`."""
    category_of = {solid.item: solid.category for solid in furniture}
    return {item: _body_and_legs(rng, category, variants) for item, category in sorted(category_of.items())}


def _body_and_legs(rng: np.random.Generator, category: str, variants: int) -> tuple[Material, Material]:
    if category == "plant":
        pot = _drawn_of(rng, ((0.5, plastic), (0.3, ceramic), (0.2, painted)), variants)
        return pot, leaf(rng, variants)
    body = _drawn_of(rng, _FURNITURE.get(category, _ANYTHING), variants)
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
    """A part of a robot as another one of its make, older or in other light, may look.

    Args:
        rng: draws the wear.
        material: as built.
        extent: 1 keeps brightness within about 40 %, hue within 15 %, roughness and metallic within 0.15.
    """
    # Log-normal brightness and channel gains, both cut at two standard deviations.
    gain = np.exp(np.clip(rng.normal(0.0, 0.17, 1), -0.34, 0.34) * extent)
    hue = np.exp(np.clip(rng.normal(0.0, 0.07, 3), -0.14, 0.14) * extent)
    # Black plastic greys with dust: uniform.
    dust = rng.uniform(0.0, 0.02) * extent
    red, green, blue = np.clip(np.array(material.base_colour_rgb) * gain * hue + dust, 0.0, 1.0).tolist()
    shift = rng.uniform(-0.15, 0.15, 2) * extent
    return Material(
        base_colour_rgb=(red, green, blue),
        metallic=float(np.clip(material.metallic + shift[0] * (material.metallic > 0.0), 0.0, 1.0)),
        roughness=float(np.clip(material.roughness + shift[1], 0.08, 1.0)),
        texture=material.texture,
        texture_scale_m=material.texture_scale_m,
    )
