"""Furniture, drawn at random: each maker gives one piece of its kind."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from rendezvous.floorplan.records import Part, Piece, box_part, legs, piece_of, pole_part

Maker = Callable[[np.random.Generator], Piece]


def _chair(x_m: float, y_m: float, yaw_rad: float) -> list[Part]:
    """Four thin legs, a seat, a back; the sitter looks along +y."""
    c, s = math.cos(yaw_rad), math.sin(yaw_rad)
    feet = [
        pole_part(x_m + c * dx - s * dy, y_m + s * dx + c * dy, 0.018, 0.0, 0.44)
        for dx in (-0.18, 0.18)
        for dy in (-0.18, 0.18)
    ]
    back_x, back_y = x_m + s * 0.19, y_m - c * 0.19
    return [
        *feet,
        box_part(x_m, y_m, 0.42, 0.42, 0.44, 0.48, yaw_rad),
        box_part(back_x, back_y, 0.42, 0.03, 0.48, 0.88, yaw_rad),
    ]


def _table_and_chairs(category: str, rng: np.random.Generator, width_m: float, depth_m: float) -> Piece:
    """A table with chairs along its long sides, pushed in or pulled out, turned a little, some missing."""
    height_m = rng.uniform(0.71, 0.76)
    parts = legs(width_m, depth_m, rng.uniform(0.022, 0.045), height_m - 0.035)
    parts.append(box_part(0.0, 0.0, width_m, depth_m, height_m - 0.035, height_m))
    per_side = max(int((width_m - 0.1) / 0.65), 1)
    for side in (-1.0, 1.0):
        for k in range(per_side):
            if rng.random() < 0.2:
                continue
            x_m = width_m * ((k + 0.5) / per_side - 0.5) + rng.uniform(-0.05, 0.05)
            y_m = side * (0.5 * depth_m + rng.uniform(-0.08, 0.2))
            parts += _chair(x_m, y_m, (0.0 if side < 0 else math.pi) + rng.normal(0.0, 0.15))
    return piece_of(category, parts, at_wall=False)


def dining_table(rng: np.random.Generator) -> Piece:
    """For two to six."""
    return _table_and_chairs("table", rng, rng.uniform(0.8, 1.9), rng.uniform(0.75, 0.95))


def meeting_table(rng: np.random.Generator) -> Piece:
    """For four to eight."""
    return _table_and_chairs("table", rng, rng.uniform(1.6, 2.8), rng.uniform(0.9, 1.2))


def round_table(rng: np.random.Generator) -> Piece:
    """A bistro table on one foot, with two to four chairs around it."""
    radius_m, height_m = rng.uniform(0.35, 0.55), rng.uniform(0.71, 0.76)
    parts = [pole_part(0.0, 0.0, rng.uniform(0.03, 0.06), 0.0, height_m - 0.03)]
    parts.append(pole_part(0.0, 0.0, radius_m, height_m - 0.03, height_m))
    turn_rad = rng.uniform(0.0, 2.0 * math.pi)
    chairs = int(rng.integers(2, 5))
    for k in range(chairs):
        heading_rad = turn_rad + 2.0 * math.pi * k / chairs
        away_m = radius_m + rng.uniform(0.05, 0.2)
        parts += _chair(
            away_m * math.sin(heading_rad),
            -away_m * math.cos(heading_rad),
            heading_rad + rng.normal(0.0, 0.15),
        )
    return piece_of("table", parts, at_wall=False)


def coffee_table(rng: np.random.Generator) -> Piece:
    """Low, but a robot passes beneath."""
    width_m, depth_m, height_m = rng.uniform(0.8, 1.2), rng.uniform(0.5, 0.65), rng.uniform(0.43, 0.5)
    parts = legs(width_m, depth_m, rng.uniform(0.02, 0.035), height_m - 0.03)
    return piece_of(
        "table", [*parts, box_part(0.0, 0.0, width_m, depth_m, height_m - 0.03, height_m)], at_wall=False
    )


def desk(rng: np.random.Generator) -> Piece:
    """On panels or legs, some with drawers, and a swivel chair before it."""
    width_m, depth_m, height_m = rng.uniform(1.1, 1.8), rng.uniform(0.6, 0.8), rng.uniform(0.7, 0.76)
    if rng.random() < 0.5:
        parts = legs(width_m, depth_m, 0.03, height_m - 0.03)
    else:
        x = 0.5 * width_m - 0.02
        parts = [box_part(sx * x, 0.0, 0.03, depth_m - 0.05, 0.0, height_m - 0.03) for sx in (-1, 1)]
    parts.append(box_part(0.0, 0.0, width_m, depth_m, height_m - 0.03, height_m))
    if rng.random() < 0.6:
        side = rng.choice([-1.0, 1.0])
        parts.append(box_part(side * (0.5 * width_m - 0.28), 0.0, 0.4, depth_m - 0.1, 0.0, 0.58))
    x_m, y_m = rng.uniform(-0.2, 0.2), 0.5 * depth_m + rng.uniform(0.0, 0.45)
    parts += [pole_part(x_m, y_m, 0.045, 0.0, 0.45), pole_part(x_m, y_m, 0.24, 0.45, 0.52)]
    parts.append(box_part(x_m, y_m + 0.22, 0.42, 0.05, 0.55, 1.0))
    return piece_of("desk", parts, at_wall=True)


def single_chair(rng: np.random.Generator) -> Piece:
    """A chair left somewhere."""
    return piece_of("chair", _chair(0.0, 0.0, rng.normal(0.0, 0.2)), at_wall=False)


def armchair(rng: np.random.Generator) -> Piece:
    """Upholstered down to the floor."""
    return _seat("armchair", rng.uniform(0.75, 0.95), rng.uniform(0.75, 0.9), at_wall=False)


def sofa(rng: np.random.Generator) -> Piece:
    """Two to four seats, at a wall."""
    return _seat("sofa", rng.uniform(1.4, 2.4), rng.uniform(0.8, 0.98), at_wall=True)


def _seat(category: str, width_m: float, depth_m: float, *, at_wall: bool) -> Piece:
    parts = [box_part(0.0, 0.0, width_m, depth_m, 0.0, 0.42)]
    parts.append(box_part(0.0, -0.5 * depth_m + 0.1, width_m, 0.2, 0.42, 0.82))
    parts += [box_part(sx * (0.5 * width_m - 0.08), 0.1, 0.16, depth_m - 0.2, 0.42, 0.6) for sx in (-1, 1)]
    return piece_of(category, parts, at_wall=at_wall)


def bed(rng: np.random.Generator) -> Piece:
    """Head to the wall, some with a nightstand."""
    width_m, length_m = rng.choice([0.95, 1.25, 1.45, 1.65]), rng.uniform(1.98, 2.1)
    parts = [box_part(0.0, 0.0, width_m, length_m, 0.0, rng.uniform(0.42, 0.6))]
    parts.append(box_part(0.0, -0.5 * length_m - 0.025, width_m, 0.05, 0.0, 1.0))
    if rng.random() < 0.6:
        x_m = rng.choice([-1.0, 1.0]) * (0.5 * width_m + 0.28)
        parts.append(box_part(x_m, -0.5 * length_m + 0.18, 0.45, 0.4, 0.0, 0.5))
    return piece_of("bed", parts, at_wall=True)


def _cupboard(
    category: str, width_m: tuple[float, float], depth_m: tuple[float, float], height_m: tuple[float, float]
) -> Maker:
    """A closed box at a wall; sizes are uniform."""

    def make(rng: np.random.Generator) -> Piece:
        parts = [
            box_part(0.0, 0.0, rng.uniform(*width_m), rng.uniform(*depth_m), 0.0, rng.uniform(*height_m))
        ]
        return piece_of(category, parts, at_wall=True)

    return make


wardrobe = _cupboard("wardrobe", (0.9, 2.2), (0.55, 0.65), (1.9, 2.2))
shelf = _cupboard("shelf", (0.6, 1.6), (0.28, 0.42), (0.9, 2.1))
drawers = _cupboard("drawers", (0.6, 1.3), (0.4, 0.5), (0.6, 0.95))
counter = _cupboard("counter", (1.4, 3.0), (0.58, 0.65), (0.88, 0.94))
appliance = _cupboard("appliance", (0.58, 0.7), (0.58, 0.68), (0.85, 1.9))
bathtub = _cupboard("bathtub", (1.5, 1.7), (0.7, 0.78), (0.5, 0.6))
radiator = _cupboard("radiator", (0.6, 1.4), (0.1, 0.16), (0.6, 0.7))


def toilet(rng: np.random.Generator) -> Piece:
    """Bowl and cistern."""
    depth_m = rng.uniform(0.42, 0.5)
    parts = [
        box_part(0.0, 0.0, 0.38, 0.18, 0.0, 0.85),
        box_part(0.0, 0.09 + 0.5 * depth_m, 0.36, depth_m, 0.0, 0.42),
    ]
    return piece_of("toilet", parts, at_wall=True)


def washbasin(rng: np.random.Generator) -> Piece:
    """A basin on a pedestal."""
    width_m = rng.uniform(0.5, 0.75)
    parts = [pole_part(0.0, 0.0, 0.1, 0.0, 0.72), box_part(0.0, 0.0, width_m, 0.45, 0.72, 0.87)]
    return piece_of("washbasin", parts, at_wall=True)


def rack(rng: np.random.Generator) -> Piece:
    """An open metal shelf: four posts, boards above a robot's height, some boxes on the floor beneath."""
    width_m, depth_m = rng.uniform(0.8, 1.8), rng.uniform(0.4, 0.6)
    parts = legs(width_m, depth_m, 0.022, 1.9)
    parts += [box_part(0.0, 0.0, width_m, depth_m, z_m, z_m + 0.03) for z_m in (0.45, 1.1, 1.8)]
    if rng.random() < 0.5:
        side_m = rng.uniform(0.28, 0.36)
        parts.append(
            box_part(rng.uniform(-0.2, 0.2) * width_m, 0.0, side_m, side_m, 0.0, rng.uniform(0.26, 0.4))
        )
    return piece_of("rack", parts, at_wall=True)


def bench(rng: np.random.Generator) -> Piece:
    """A plank on legs along a wall."""
    width_m = rng.uniform(1.0, 1.7)
    parts = legs(width_m, 0.4, 0.03, 0.43)
    return piece_of("bench", [*parts, box_part(0.0, 0.0, width_m, 0.4, 0.43, 0.47)], at_wall=True)


def boxes(rng: np.random.Generator) -> Piece:
    """One to three cartons next to each other, each turned its own way."""
    parts = []
    x_m = 0.0
    for _ in range(int(rng.integers(1, 4))):
        width_m, depth_m = rng.uniform(0.25, 0.55, size=2)
        y_m, yaw_rad = rng.uniform(-0.1, 0.1), rng.normal(0.0, 0.3)
        parts.append(box_part(x_m, y_m, width_m, depth_m, 0.0, rng.uniform(0.26, 0.8), yaw_rad))
        x_m += 0.5 * width_m + rng.uniform(0.25, 0.4)
    return piece_of("boxes", parts, at_wall=bool(rng.random() < 0.6))


def plant(rng: np.random.Generator) -> Piece:
    """A pot and what grows in it."""
    parts = [pole_part(0.0, 0.0, rng.uniform(0.11, 0.22), 0.0, rng.uniform(0.26, 0.42))]
    parts.append(pole_part(0.0, 0.0, rng.uniform(0.2, 0.35), 0.5, rng.uniform(0.9, 1.6)))
    return piece_of("plant", parts, at_wall=bool(rng.random() < 0.7))


def pole(rng: np.random.Generator) -> Piece:
    """A floor lamp, coat stand or bare pipe."""
    parts = [pole_part(0.0, 0.0, rng.uniform(0.018, 0.05), 0.0, rng.uniform(1.5, 1.9))]
    return piece_of("pole", parts, at_wall=bool(rng.random() < 0.6))


def bin_(rng: np.random.Generator) -> Piece:
    """A waste bin."""
    parts = [pole_part(0.0, 0.0, rng.uniform(0.11, 0.2), 0.0, rng.uniform(0.27, 0.65))]
    return piece_of("bin", parts, at_wall=bool(rng.random() < 0.8))


def pallet(rng: np.random.Generator) -> Piece:
    """One or two loaded pallets side by side."""
    count, height_m = int(rng.integers(1, 3)), rng.uniform(0.3, 1.6)
    return piece_of("pallet", [box_part(0.0, 0.0, 1.2, 0.8 * count, 0.0, height_m)], at_wall=False)


def stall(rng: np.random.Generator) -> Piece:
    """A booth of partitions, open in front, some with a counter behind the opening."""
    width_m, depth_m, height_m = rng.uniform(1.8, 3.2), rng.uniform(1.4, 2.4), rng.uniform(1.4, 2.2)
    x, y = 0.5 * width_m, 0.5 * depth_m
    parts = [box_part(0.0, -y, width_m, 0.05, 0.0, height_m)]
    parts += [box_part(sx * x, 0.0, 0.05, depth_m, 0.0, height_m) for sx in (-1, 1)]
    if rng.random() < 0.4:
        parts.append(box_part(0.0, 0.0, 0.5 * width_m, 0.4, 0.0, rng.uniform(0.8, 1.1)))
    return piece_of("stall", parts, at_wall=False)


def screen(rng: np.random.Generator) -> Piece:
    """A movable partition or whiteboard."""
    parts = [box_part(0.0, 0.0, rng.uniform(0.9, 1.6), 0.05, 0.0, rng.uniform(1.3, 1.8))]
    return piece_of("screen", parts, at_wall=False)
