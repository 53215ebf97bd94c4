"""Small scenes that tests of several rooms share."""

from __future__ import annotations

import math

import numpy as np

from rendezvous.floorplan.records import Shape, Solid
from rendezvous.geometry.se2 import Array
from rendezvous.robot_file import load_robot
from rendezvous.simulation.robot import RobotSpec


def burger() -> RobotSpec:
    return load_robot("burger")


def wall(x0_m: float, y0_m: float, x1_m: float, y1_m: float) -> Solid:
    """A thin wall box from one point to another."""
    return Solid(
        shape=Shape.BOX,
        x_m=0.5 * (x0_m + x1_m),
        y_m=0.5 * (y0_m + y1_m),
        yaw_rad=math.atan2(y1_m - y0_m, x1_m - x0_m),
        half_x_m=0.5 * math.hypot(x1_m - x0_m, y1_m - y0_m),
        half_y_m=0.01,
        z0_m=0.0,
        z1_m=2.5,
        category="wall",
    )


def pole(x_m: float, y_m: float, radius_m: float, *, z0_m: float = 0.0, z1_m: float = 1.0) -> Solid:
    return Solid(
        shape=Shape.CYLINDER,
        x_m=x_m,
        y_m=y_m,
        yaw_rad=0.0,
        half_x_m=radius_m,
        half_y_m=radius_m,
        z0_m=z0_m,
        z1_m=z1_m,
        category="pole",
    )


def room_segments(width_m: float, height_m: float) -> Array:
    """(4, 4) the walls of a rectangular room whose corner is the origin, free space to their left."""
    corners = np.array([[0, 0], [width_m, 0], [width_m, height_m], [0, height_m]], float)
    return np.hstack([corners, np.roll(corners, -1, axis=0)])
