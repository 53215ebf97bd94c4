"""Rigid motions of the plane."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import overload

import numpy as np
from numpy.typing import NDArray

from rendezvous.errors import PipelineError

Array = NDArray[np.float64]


def wrap_angle(angle_rad: float) -> float:
    """The same angle in (-pi, pi] [rad]."""
    wrapped = math.remainder(angle_rad, 2.0 * math.pi)
    return math.pi if wrapped == -math.pi else wrapped


@dataclass(frozen=True, slots=True)
class SE2:
    """An SE(2) pose. `T_a_b` is the pose of frame b in frame a and carries points from b to a.

    The heading is kept as given (not wrapped), so that a trajectory's yaw can be unrolled; `wrapped()`
    gives the form of Eq. 1 of the paper, yaw in (-pi, pi].
    """

    x_m: float
    y_m: float
    yaw_rad: float

    def __post_init__(self) -> None:
        if not type(self.x_m) is type(self.y_m) is type(self.yaw_rad) is float:
            for name in ("x_m", "y_m", "yaw_rad"):
                object.__setattr__(self, name, float(getattr(self, name)))
        if not (math.isfinite(self.x_m) and math.isfinite(self.y_m) and math.isfinite(self.yaw_rad)):
            raise PipelineError(
                f"SE(2) pose ({self.x_m}, {self.y_m}, {self.yaw_rad}) is not finite; "
                "x [m], y [m] and yaw [rad] must be numbers"
            )

    @staticmethod
    def identity() -> SE2:
        """The pose that moves nothing."""
        return SE2(0.0, 0.0, 0.0)

    @staticmethod
    def from_array(xyyaw: Array | tuple[float, ...] | list[float]) -> SE2:
        """From (3,) x [m], y [m], yaw [rad]."""
        x_m, y_m, yaw_rad = (float(v) for v in xyyaw)
        return SE2(x_m, y_m, yaw_rad)

    def as_array(self) -> Array:
        """(3,) float64: x [m], y [m], yaw [rad]."""
        return np.array([self.x_m, self.y_m, self.yaw_rad])

    def matrix(self) -> Array:
        """(3, 3) homogeneous matrix (Eq. 1 of the paper)."""
        c, s = math.cos(self.yaw_rad), math.sin(self.yaw_rad)
        return np.array([[c, -s, self.x_m], [s, c, self.y_m], [0.0, 0.0, 1.0]])

    def inverse(self) -> SE2:
        """`T_b_a` of this `T_a_b`."""
        c, s = math.cos(self.yaw_rad), math.sin(self.yaw_rad)
        return SE2(-c * self.x_m - s * self.y_m, s * self.x_m - c * self.y_m, -self.yaw_rad)

    def wrapped(self) -> SE2:
        """The same pose with yaw in (-pi, pi]."""
        return SE2(self.x_m, self.y_m, wrap_angle(self.yaw_rad))

    @overload
    def __matmul__(self, other: SE2) -> SE2: ...
    @overload
    def __matmul__(self, other: Array) -> Array: ...
    def __matmul__(self, other: SE2 | Array) -> SE2 | Array:
        """`T_a_b @ T_b_c`, or `T_a_b @ p_b` for points (..., 2) [m]."""
        c, s = math.cos(self.yaw_rad), math.sin(self.yaw_rad)
        if isinstance(other, SE2):
            return SE2(
                self.x_m + c * other.x_m - s * other.y_m,
                self.y_m + s * other.x_m + c * other.y_m,
                self.yaw_rad + other.yaw_rad,
            )
        x, y = other[..., 0], other[..., 1]
        return np.stack([self.x_m + c * x - s * y, self.y_m + s * x + c * y], axis=-1)
