"""Pieces of furniture, each in its own frame s: on the floor, back to -y, front to +y."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from pipeline.floorplan.records import Shape, Solid
from pipeline.geometry.se2 import Array

DRIVE_UNDER_M = 0.4
"""What hangs at least this high leaves room for a robot beneath; everything else stands on the floor."""


class Part(NamedTuple):
    """A box or cylinder of a piece, in the piece's frame; fields as of `Solid`."""

    shape: Shape
    x_m: float
    y_m: float
    yaw_rad: float
    half_x_m: float
    half_y_m: float
    z0_m: float
    z1_m: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Piece:
    """A piece of furniture at the origin.

    Attributes:
        category: what it is.
        half_x_m, half_y_m: half sides of the rectangle around it, chairs included.
        parts: its solids in its own frame.
        at_wall: whether it stands with its back to a wall.
    """

    category: str
    half_x_m: float
    half_y_m: float
    parts: tuple[Part, ...]
    at_wall: bool

    def standing_at(self, pose: Array, shape: Shape) -> Array:
        """(N, 5) x [m], y [m], yaw [rad], half sides [m] in w of the parts of this shape on the floor.

        Args:
            pose: (3,) x [m], y [m], yaw [rad] of the piece.
            shape: which parts.
        """
        standing = [p for p in self.parts if p.shape is shape and p.z0_m < DRIVE_UNDER_M]
        rows = np.array([(p.x_m, p.y_m, p.yaw_rad, p.half_x_m, p.half_y_m) for p in standing])
        rows = rows.reshape(-1, 5)
        cos, sin = math.cos(pose[2]), math.sin(pose[2])
        x_m = pose[0] + cos * rows[:, 0] - sin * rows[:, 1]
        y_m = pose[1] + sin * rows[:, 0] + cos * rows[:, 1]
        return np.column_stack([x_m, y_m, rows[:, 2] + pose[2], rows[:, 3:]])

    def placed(self, pose: Array, *, item: int) -> tuple[Solid, ...]:
        """Its solids with the piece's frame at this pose (3,) x [m], y [m], yaw [rad] in w."""
        x_m, y_m, yaw_rad = pose.tolist()
        cos, sin = math.cos(yaw_rad), math.sin(yaw_rad)
        return tuple(
            Solid(
                shape=part.shape,
                x_m=x_m + cos * part.x_m - sin * part.y_m,
                y_m=y_m + sin * part.x_m + cos * part.y_m,
                yaw_rad=yaw_rad + part.yaw_rad,
                half_x_m=part.half_x_m,
                half_y_m=part.half_y_m,
                z0_m=part.z0_m,
                z1_m=part.z1_m,
                category=self.category,
                item=item,
            )
            for part in self.parts
        )


Maker = Callable[[np.random.Generator], Piece]


def _box(
    x_m: float, y_m: float, width_m: float, depth_m: float, z0_m: float, z1_m: float, yaw_rad: float = 0.0
) -> Part:
    return Part(Shape.BOX, x_m, y_m, yaw_rad, 0.5 * width_m, 0.5 * depth_m, z0_m, z1_m)


def _pole(x_m: float, y_m: float, radius_m: float, z0_m: float, z1_m: float) -> Part:
    return Part(Shape.CYLINDER, x_m, y_m, 0.0, radius_m, radius_m, z0_m, z1_m)


def _legs(width_m: float, depth_m: float, radius_m: float, height_m: float) -> list[Part]:
    """Four round legs at the corners of a rectangle."""
    x, y = 0.5 * width_m - radius_m - 0.02, 0.5 * depth_m - radius_m - 0.02
    return [_pole(sx * x, sy * y, radius_m, 0.0, height_m) for sx in (-1, 1) for sy in (-1, 1)]


def _chair(x_m: float, y_m: float, yaw_rad: float) -> list[Part]:
    """Four thin legs, a seat, a back; the sitter looks along +y."""
    c, s = math.cos(yaw_rad), math.sin(yaw_rad)
    legs = [
        _pole(x_m + c * dx - s * dy, y_m + s * dx + c * dy, 0.018, 0.0, 0.44)
        for dx in (-0.18, 0.18)
        for dy in (-0.18, 0.18)
    ]
    back_x, back_y = x_m + s * 0.19, y_m - c * 0.19
    return [
        *legs,
        _box(x_m, y_m, 0.42, 0.42, 0.44, 0.48, yaw_rad),
        _box(back_x, back_y, 0.42, 0.03, 0.48, 0.88, yaw_rad),
    ]


def _table_and_chairs(category: str, rng: np.random.Generator, width_m: float, depth_m: float) -> Piece:
    """A table with chairs along its long sides, pushed in or pulled out, turned a little, some missing."""
    height_m = rng.uniform(0.71, 0.76)
    parts = _legs(width_m, depth_m, rng.uniform(0.022, 0.045), height_m - 0.035)
    parts.append(_box(0.0, 0.0, width_m, depth_m, height_m - 0.035, height_m))
    per_side = max(int((width_m - 0.1) / 0.65), 1)
    for side in (-1.0, 1.0):
        for k in range(per_side):
            if rng.random() < 0.2:
                continue
            x_m = width_m * ((k + 0.5) / per_side - 0.5) + rng.uniform(-0.05, 0.05)
            y_m = side * (0.5 * depth_m + rng.uniform(-0.08, 0.2))
            parts += _chair(x_m, y_m, (0.0 if side < 0 else math.pi) + rng.normal(0.0, 0.15))
    return _piece(category, parts, at_wall=False)


def _piece(category: str, parts: list[Part], *, at_wall: bool) -> Piece:
    """The piece, its frame moved to the middle of the rectangle around its parts."""
    x0 = y0 = math.inf
    x1 = y1 = -math.inf
    for part in parts:
        cos, sin = abs(math.cos(part.yaw_rad)), abs(math.sin(part.yaw_rad))
        reach_x, reach_y = (
            cos * part.half_x_m + sin * part.half_y_m,
            sin * part.half_x_m + cos * part.half_y_m,
        )
        x0, x1 = min(x0, part.x_m - reach_x), max(x1, part.x_m + reach_x)
        y0, y1 = min(y0, part.y_m - reach_y), max(y1, part.y_m + reach_y)
    x_m, y_m = 0.5 * (x0 + x1), 0.5 * (y0 + y1)
    return Piece(
        category=category,
        half_x_m=0.5 * (x1 - x0),
        half_y_m=0.5 * (y1 - y0),
        parts=tuple(part._replace(x_m=part.x_m - x_m, y_m=part.y_m - y_m) for part in parts),
        at_wall=at_wall,
    )


def dining_table(rng: np.random.Generator) -> Piece:
    """For two to six."""
    return _table_and_chairs("table", rng, rng.uniform(0.8, 1.9), rng.uniform(0.75, 0.95))


def meeting_table(rng: np.random.Generator) -> Piece:
    """For four to eight."""
    return _table_and_chairs("table", rng, rng.uniform(1.6, 2.8), rng.uniform(0.9, 1.2))


def round_table(rng: np.random.Generator) -> Piece:
    """A bistro table on one foot, with two to four chairs around it."""
    radius_m, height_m = rng.uniform(0.35, 0.55), rng.uniform(0.71, 0.76)
    parts = [_pole(0.0, 0.0, rng.uniform(0.03, 0.06), 0.0, height_m - 0.03)]
    parts.append(_pole(0.0, 0.0, radius_m, height_m - 0.03, height_m))
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
    return _piece("table", parts, at_wall=False)


def coffee_table(rng: np.random.Generator) -> Piece:
    """Low, but a robot passes beneath."""
    width_m, depth_m, height_m = rng.uniform(0.8, 1.2), rng.uniform(0.5, 0.65), rng.uniform(0.43, 0.5)
    parts = _legs(width_m, depth_m, rng.uniform(0.02, 0.035), height_m - 0.03)
    return _piece(
        "table", [*parts, _box(0.0, 0.0, width_m, depth_m, height_m - 0.03, height_m)], at_wall=False
    )


def desk(rng: np.random.Generator) -> Piece:
    """On panels or legs, some with drawers, and a swivel chair before it."""
    width_m, depth_m, height_m = rng.uniform(1.1, 1.8), rng.uniform(0.6, 0.8), rng.uniform(0.7, 0.76)
    if rng.random() < 0.5:
        parts = _legs(width_m, depth_m, 0.03, height_m - 0.03)
    else:
        x = 0.5 * width_m - 0.02
        parts = [_box(sx * x, 0.0, 0.03, depth_m - 0.05, 0.0, height_m - 0.03) for sx in (-1, 1)]
    parts.append(_box(0.0, 0.0, width_m, depth_m, height_m - 0.03, height_m))
    if rng.random() < 0.6:
        side = rng.choice([-1.0, 1.0])
        parts.append(_box(side * (0.5 * width_m - 0.28), 0.0, 0.4, depth_m - 0.1, 0.0, 0.58))
    x_m, y_m = rng.uniform(-0.2, 0.2), 0.5 * depth_m + rng.uniform(0.0, 0.45)
    parts += [_pole(x_m, y_m, 0.045, 0.0, 0.45), _pole(x_m, y_m, 0.24, 0.45, 0.52)]
    parts.append(_box(x_m, y_m + 0.22, 0.42, 0.05, 0.55, 1.0))
    return _piece("desk", parts, at_wall=True)


def single_chair(rng: np.random.Generator) -> Piece:
    """A chair left somewhere."""
    return _piece("chair", _chair(0.0, 0.0, rng.normal(0.0, 0.2)), at_wall=False)


def armchair(rng: np.random.Generator) -> Piece:
    """Upholstered down to the floor."""
    return _seat("armchair", rng.uniform(0.75, 0.95), rng.uniform(0.75, 0.9), at_wall=False)


def sofa(rng: np.random.Generator) -> Piece:
    """Two to four seats, at a wall."""
    return _seat("sofa", rng.uniform(1.4, 2.4), rng.uniform(0.8, 0.98), at_wall=True)


def _seat(category: str, width_m: float, depth_m: float, *, at_wall: bool) -> Piece:
    parts = [_box(0.0, 0.0, width_m, depth_m, 0.0, 0.42)]
    parts.append(_box(0.0, -0.5 * depth_m + 0.1, width_m, 0.2, 0.42, 0.82))
    parts += [_box(sx * (0.5 * width_m - 0.08), 0.1, 0.16, depth_m - 0.2, 0.42, 0.6) for sx in (-1, 1)]
    return _piece(category, parts, at_wall=at_wall)


def bed(rng: np.random.Generator) -> Piece:
    """Head to the wall, some with a nightstand."""
    width_m, length_m = rng.choice([0.95, 1.25, 1.45, 1.65]), rng.uniform(1.98, 2.1)
    parts = [_box(0.0, 0.0, width_m, length_m, 0.0, rng.uniform(0.42, 0.6))]
    parts.append(_box(0.0, -0.5 * length_m - 0.025, width_m, 0.05, 0.0, 1.0))
    if rng.random() < 0.6:
        x_m = rng.choice([-1.0, 1.0]) * (0.5 * width_m + 0.28)
        parts.append(_box(x_m, -0.5 * length_m + 0.18, 0.45, 0.4, 0.0, 0.5))
    return _piece("bed", parts, at_wall=True)


def _cupboard(
    category: str, width_m: tuple[float, float], depth_m: tuple[float, float], height_m: tuple[float, float]
) -> Maker:
    """A closed box at a wall; sizes are uniform."""

    def make(rng: np.random.Generator) -> Piece:
        parts = [_box(0.0, 0.0, rng.uniform(*width_m), rng.uniform(*depth_m), 0.0, rng.uniform(*height_m))]
        return _piece(category, parts, at_wall=True)

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
    parts = [_box(0.0, 0.0, 0.38, 0.18, 0.0, 0.85), _box(0.0, 0.09 + 0.5 * depth_m, 0.36, depth_m, 0.0, 0.42)]
    return _piece("toilet", parts, at_wall=True)


def washbasin(rng: np.random.Generator) -> Piece:
    """A basin on a pedestal."""
    width_m = rng.uniform(0.5, 0.75)
    parts = [_pole(0.0, 0.0, 0.1, 0.0, 0.72), _box(0.0, 0.0, width_m, 0.45, 0.72, 0.87)]
    return _piece("washbasin", parts, at_wall=True)


def rack(rng: np.random.Generator) -> Piece:
    """An open metal shelf: four posts, boards above a robot's height, some boxes on the floor beneath."""
    width_m, depth_m = rng.uniform(0.8, 1.8), rng.uniform(0.4, 0.6)
    parts = _legs(width_m, depth_m, 0.022, 1.9)
    parts += [_box(0.0, 0.0, width_m, depth_m, z_m, z_m + 0.03) for z_m in (0.45, 1.1, 1.8)]
    if rng.random() < 0.5:
        side_m = rng.uniform(0.28, 0.36)
        parts.append(_box(rng.uniform(-0.2, 0.2) * width_m, 0.0, side_m, side_m, 0.0, rng.uniform(0.26, 0.4)))
    return _piece("rack", parts, at_wall=True)


def bench(rng: np.random.Generator) -> Piece:
    """A plank on legs along a wall."""
    width_m = rng.uniform(1.0, 1.7)
    parts = _legs(width_m, 0.4, 0.03, 0.43)
    return _piece("bench", [*parts, _box(0.0, 0.0, width_m, 0.4, 0.43, 0.47)], at_wall=True)


def boxes(rng: np.random.Generator) -> Piece:
    """One to three cartons next to each other, each turned its own way."""
    parts = []
    x_m = 0.0
    for _ in range(int(rng.integers(1, 4))):
        width_m, depth_m = rng.uniform(0.25, 0.55, size=2)
        y_m, yaw_rad = rng.uniform(-0.1, 0.1), rng.normal(0.0, 0.3)
        parts.append(_box(x_m, y_m, width_m, depth_m, 0.0, rng.uniform(0.26, 0.8), yaw_rad))
        x_m += 0.5 * width_m + rng.uniform(0.25, 0.4)
    return _piece("boxes", parts, at_wall=bool(rng.random() < 0.6))


def plant(rng: np.random.Generator) -> Piece:
    """A pot and what grows in it."""
    parts = [_pole(0.0, 0.0, rng.uniform(0.11, 0.22), 0.0, rng.uniform(0.26, 0.42))]
    parts.append(_pole(0.0, 0.0, rng.uniform(0.2, 0.35), 0.5, rng.uniform(0.9, 1.6)))
    return _piece("plant", parts, at_wall=bool(rng.random() < 0.7))


def pole(rng: np.random.Generator) -> Piece:
    """A floor lamp, coat stand or bare pipe."""
    parts = [_pole(0.0, 0.0, rng.uniform(0.018, 0.05), 0.0, rng.uniform(1.5, 1.9))]
    return _piece("pole", parts, at_wall=bool(rng.random() < 0.6))


def bin_(rng: np.random.Generator) -> Piece:
    """A waste bin."""
    parts = [_pole(0.0, 0.0, rng.uniform(0.11, 0.2), 0.0, rng.uniform(0.27, 0.65))]
    return _piece("bin", parts, at_wall=bool(rng.random() < 0.8))


def screen(rng: np.random.Generator) -> Piece:
    """A movable partition or whiteboard."""
    parts = [_box(0.0, 0.0, rng.uniform(0.9, 1.6), 0.05, 0.0, rng.uniform(1.3, 1.8))]
    return _piece("screen", parts, at_wall=False)
