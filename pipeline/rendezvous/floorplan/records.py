"""Floor plans, solids, and furniture made of them.

World frame w: the plan's own axes, floor at z = 0. Frame s of a piece of furniture: on the floor in its
middle, back to -y, front to +y.
"""

from __future__ import annotations

import hashlib
import math
from dataclasses import dataclass
from enum import StrEnum
from typing import NamedTuple

import numpy as np
from shapely import Polygon

from rendezvous.errors import FloorplanError
from rendezvous.geometry.se2 import SE2, Array


@dataclass(frozen=True, slots=True, kw_only=True)
class Room:
    """A room's label: its category and its axis-aligned box x0, y0, x1, y1 [m]; boxes may overlap."""

    category: str
    box_m: tuple[float, float, float, float]


@dataclass(frozen=True, slots=True, kw_only=True)
class Floorplan:
    """A validated floor plan: the free space of one storey; all else is wall."""

    plan_id: str  # unique name
    outline_m: Array  # (N, 2) float64 [m], the free space's outer ring, counter-clockwise, not closed
    holes_m: tuple[Array, ...] = ()  # islands of wall inside it, each (M, 2) [m], clockwise, not closed
    rooms: tuple[Room, ...] = ()  # labels

    def __post_init__(self) -> None:
        for ring in (self.outline_m, *self.holes_m):
            if ring.ndim != 2 or ring.shape[1] != 2 or len(ring) < 3:
                raise FloorplanError(
                    f"{self.plan_id}: a ring of shape {ring.shape}; needs at least 3 vertices (N, 2)"
                )

    def digest(self) -> str:
        """Stable hash of the geometry, to the millimetre; splits and resume are keyed by it."""
        h = hashlib.sha256()
        for ring in (self.outline_m, *self.holes_m):
            h.update(len(ring).to_bytes(4, "little"))
            h.update(np.round(ring * 1000.0).astype("<i8").tobytes())
        return h.hexdigest()

    def free_space(self) -> Polygon:
        """The free space as a polygon [m]: inside the outline, outside the holes."""
        return Polygon(self.outline_m, self.holes_m)

    def edges_m(self) -> Array:
        """(E, 4) x0, y0, x1, y1 [m] of all wall faces; free space lies to the left of each."""
        return np.concatenate(
            [np.hstack([ring, np.roll(ring, -1, axis=0)]) for ring in (self.outline_m, *self.holes_m)]
        )


class Shape(StrEnum):
    """Form of a solid's footprint."""

    BOX = "box"
    CYLINDER = "cylinder"


@dataclass(frozen=True, slots=True, kw_only=True)
class Solid:
    """An upright box or cylinder: part of a wall or of a piece of furniture."""

    shape: Shape  # form of the footprint
    # x_m, y_m, yaw_rad: pose of the footprint's centre in w.
    x_m: float
    y_m: float
    yaw_rad: float
    # half_x_m, half_y_m: half sides of the footprint; both the radius for a cylinder.
    half_x_m: float
    half_y_m: float
    # z0_m, z1_m: heights of bottom and top above the floor.
    z0_m: float
    z1_m: float
    category: str  # the thing it is part of ("wall", "table", "sofa", ...)
    item: int = -1  # index of the piece of furniture it belongs to; -1 for walls

    def __post_init__(self) -> None:
        if not (self.half_x_m > 0 and self.half_y_m > 0 and self.z1_m > self.z0_m >= 0):
            raise FloorplanError(
                f"{self.category} at ({self.x_m:.2f}, {self.y_m:.2f}) m has no volume: half sides "
                f"{self.half_x_m}, {self.half_y_m} m, z from {self.z0_m} to {self.z1_m} m"
            )

    def T_w_s(self) -> SE2:
        """Pose of the footprint's centre."""
        return SE2(self.x_m, self.y_m, self.yaw_rad)

    def corners_m(self) -> Array:
        """(4, 2) [m] corners of a box's footprint, counter-clockwise; of a cylinder, its bounding square."""
        signs = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
        return self.T_w_s() @ (signs * (self.half_x_m, self.half_y_m))


DRIVE_UNDER_M = 0.4  # a part that starts this high leaves room for a robot beneath; others stand on the floor


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
    """A piece of furniture at the origin."""

    category: str  # "table", "sofa", ...
    # half_x_m, half_y_m: half sides of the rectangle around it, chairs included.
    half_x_m: float
    half_y_m: float
    parts: tuple[Part, ...]  # its solids in its own frame
    at_wall: bool  # whether it stands with its back to a wall

    def standing_at(self, pose: Array, shape: Shape) -> Array:
        """(N, 5) x [m], y [m], yaw [rad], half sides [m] in w of the parts of this shape on the floor."""
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
        placed = [
            part._replace(
                x_m=x_m + cos * part.x_m - sin * part.y_m,
                y_m=y_m + sin * part.x_m + cos * part.y_m,
                yaw_rad=yaw_rad + part.yaw_rad,
            )
            for part in self.parts
        ]
        return tuple(Solid(**part._asdict(), category=self.category, item=item) for part in placed)


def box_part(
    x_m: float, y_m: float, width_m: float, depth_m: float, z0_m: float, z1_m: float, yaw_rad: float = 0.0
) -> Part:
    """A box by its middle, its whole width along x and depth along y, and its heights."""
    return Part(Shape.BOX, x_m, y_m, yaw_rad, 0.5 * width_m, 0.5 * depth_m, z0_m, z1_m)


def pole_part(x_m: float, y_m: float, radius_m: float, z0_m: float, z1_m: float) -> Part:
    """An upright cylinder."""
    return Part(Shape.CYLINDER, x_m, y_m, 0.0, radius_m, radius_m, z0_m, z1_m)


def legs(width_m: float, depth_m: float, radius_m: float, height_m: float) -> list[Part]:
    """Four round legs at the corners of a rectangle."""
    x, y = 0.5 * width_m - radius_m - 0.02, 0.5 * depth_m - radius_m - 0.02
    return [pole_part(sx * x, sy * y, radius_m, 0.0, height_m) for sx in (-1, 1) for sy in (-1, 1)]


def piece_of(category: str, parts: list[Part], *, at_wall: bool) -> Piece:
    """The piece, its frame moved to the middle of the rectangle around its parts."""
    x0 = y0 = math.inf
    x1 = y1 = -math.inf
    for part in parts:
        cos, sin = abs(math.cos(part.yaw_rad)), abs(math.sin(part.yaw_rad))
        reach_x = cos * part.half_x_m + sin * part.half_y_m
        reach_y = sin * part.half_x_m + cos * part.half_y_m
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
