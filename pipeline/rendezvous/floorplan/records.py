"""Floor plans and solids. World frame w: the plan's own axes, floor at z = 0."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from enum import StrEnum

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
