"""Small things: meshes of the pool in a frame t of their own, on the floor at the thing's centre, z up."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from rendezvous.geometry.camera import se3_from_se2
from rendezvous.geometry.se2 import SE2, Array
from rendezvous.rendering.plan_scene import BOX
from rendezvous.rendering.scene import Instance, Material


@dataclass(frozen=True, slots=True, kw_only=True)
class ThingPart:
    """A mesh of the pool (by key) in the thing's frame: `T_t` is its (4, 4) pose, which scales it."""

    mesh: str
    T_t: Array
    material: Material


@dataclass(frozen=True, slots=True, kw_only=True)
class Thing:
    """A small thing.

    Attributes:
        kind: key into `distractors.THINGS`.
        parts: its parts.
        radius_m: radius of the circle about the frame's origin that contains it.
        height_m: height of its top.
    """

    kind: str
    parts: tuple[ThingPart, ...]
    radius_m: float
    height_m: float

    def instances(self, T_w_t: Array, *, name: str) -> tuple[Instance, ...]:
        """Its parts at a pose (4, 4), named `name/0`, `name/1`, ..."""
        return tuple(
            Instance(name=f"{name}/{i}", mesh=part.mesh, T_w=T_w_t @ part.T_t, material=part.material)
            for i, part in enumerate(self.parts)
        )


ThingDraw = Callable[[np.random.Generator, int], Thing]
"""Draws a thing; the int is the texture pool's number of variants of each kind."""


def sized(x_m: float, y_m: float, z_m: float, *, up_m: float = 0.0, yaw_rad: float = 0.0) -> Array:
    """Pose that scales a unit mesh to these sides, turns it about z and raises it."""
    T_t = se3_from_se2(SE2(0.0, 0.0, yaw_rad))
    T_t[:3, :3] *= (x_m, y_m, z_m)
    T_t[2, 3] = up_m
    return T_t


def block(
    x_m: float,
    y_m: float,
    z_m: float,
    material: Material,
    *,
    up_m: float = 0.0,
    yaw_rad: float = 0.0,
    aside_m: float = 0.0,
) -> ThingPart:
    """A box with these sides and its bottom at `up_m`, shifted along its own y axis."""
    T_t = sized(x_m, y_m, z_m, up_m=up_m + 0.5 * z_m, yaw_rad=yaw_rad)
    T_t[:2, 3] = -math.sin(yaw_rad) * aside_m, math.cos(yaw_rad) * aside_m
    return ThingPart(mesh=BOX, T_t=T_t, material=material)
