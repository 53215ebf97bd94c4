"""Dead reckoning from wheel encoders."""

from __future__ import annotations

import math

import numpy as np

from rendezvous.geometry.se2 import Array


class WheelOdometry:
    """Integrates wheel angles into a pose; the pose at the first reading is the origin.

    Args:
        wheel_radius_m: nominal radius of the wheels.
        track_m: nominal distance between the wheels.
    """

    def __init__(self, *, wheel_radius_m: float, track_m: float) -> None:
        self._radius_m = wheel_radius_m
        self._track_m = track_m
        self._last_rad: tuple[float, float] | None = None
        self._x_m = self._y_m = self._yaw_rad = 0.0

    def update(self, wheels_rad: tuple[float, float]) -> None:
        """Take the next reading: left and right wheel angle [rad]."""
        if self._last_rad is not None:
            left_m = self._radius_m * (wheels_rad[0] - self._last_rad[0])
            right_m = self._radius_m * (wheels_rad[1] - self._last_rad[1])
            turn = (right_m - left_m) / self._track_m
            heading = self._yaw_rad + 0.5 * turn
            forward_m = 0.5 * (left_m + right_m)
            self._x_m += forward_m * math.cos(heading)
            self._y_m += forward_m * math.sin(heading)
            self._yaw_rad += turn
        self._last_rad = wheels_rad

    def pose(self) -> Array:
        """(3,) x, y [m] and yaw [rad], unrolled, in the odometry frame."""
        return np.array([self._x_m, self._y_m, self._yaw_rad])
