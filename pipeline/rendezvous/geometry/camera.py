"""The pinhole camera. Camera frame c: x right, y down, z forward (OpenCV)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rendezvous.errors import PipelineError
from rendezvous.geometry.se2 import SE2, Array

Image = NDArray[np.uint8]  # (H, W, 3) red, green, blue


@dataclass(frozen=True, slots=True, kw_only=True)
class PinholeCamera:
    """Intrinsics of an undistorted camera. Pixel (0, 0) is the centre of the first pixel.

    Attributes:
        fx_px, fy_px: focal lengths [px].
        cx_px, cy_px: principal point [px].
        width_px, height_px: image size [px].
    """

    fx_px: float
    fy_px: float
    cx_px: float
    cy_px: float
    width_px: int
    height_px: int

    def __post_init__(self) -> None:
        if not (self.fx_px > 0 and self.fy_px > 0 and self.width_px > 0 and self.height_px > 0):
            raise PipelineError(
                f"camera: fx {self.fx_px}, fy {self.fy_px}, size {self.width_px}x{self.height_px} px; "
                "focal lengths and size must be positive"
            )

    @staticmethod
    def of_matrix(K: Array, width_px: int, height_px: int) -> PinholeCamera:
        """The camera with this matrix (3, 3) [px], which has no skew."""
        return PinholeCamera(
            fx_px=float(K[0, 0]),
            fy_px=float(K[1, 1]),
            cx_px=float(K[0, 2]),
            cy_px=float(K[1, 2]),
            width_px=width_px,
            height_px=height_px,
        )

    def K(self) -> Array:
        """(3, 3) camera matrix [px]."""
        return np.array([[self.fx_px, 0.0, self.cx_px], [0.0, self.fy_px, self.cy_px], [0.0, 0.0, 1.0]])

    def project(self, p_c: Array) -> Array:
        """(N, 2) pixels of points (N, 3) [m] in the camera frame; NaN for points behind the camera."""
        z = np.where(p_c[:, 2] > 0.0, p_c[:, 2], np.nan)
        u = self.fx_px * p_c[:, 0] / z + self.cx_px
        v = self.fy_px * p_c[:, 1] / z + self.cy_px
        return np.stack([u, v], axis=1)

    def in_image(self, uv_px: Array) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
        """(N,) bool: which pixels (N, 2) lie on the image, whose outer edge is at -0.5."""
        u, v = uv_px[:, 0], uv_px[:, 1]
        return (u >= -0.5) & (u < self.width_px - 0.5) & (v >= -0.5) & (v < self.height_px - 0.5)


def rotation_from_rpy(roll_rad: float, pitch_rad: float, yaw_rad: float) -> Array:
    """(3, 3) rotation Rz(yaw) Ry(pitch) Rx(roll), ROS's fixed-axis convention."""
    cr, sr = np.cos(roll_rad), np.sin(roll_rad)
    cp, sp = np.cos(pitch_rad), np.sin(pitch_rad)
    cy, sy = np.cos(yaw_rad), np.sin(yaw_rad)
    return np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )


# Columns: the optical axes (x right, y down, z forward) in a body frame with x forward, y left, z up.
R_BODY_OPTICAL: Array = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])


def camera_pose(xyz_m: Array, rpy_rad: Array) -> Array:
    """(4, 4) `T_r_c`: pose of the optical frame of a camera mounted at xyz, rpy of its body (x forward)."""
    T_r_c = np.eye(4)
    T_r_c[:3, :3] = rotation_from_rpy(*rpy_rad) @ R_BODY_OPTICAL
    T_r_c[:3, 3] = xyz_m
    return T_r_c


def se3_from_se2(pose: SE2) -> Array:
    """(4, 4) pose on the floor of an SE(2) pose."""
    T = np.eye(4)
    T[:2, [0, 1, 3]] = pose.matrix()[:2]
    return T


def se2_from_se3(T: Array) -> SE2:
    """x [m], y [m] and yaw [rad] of a (4, 4) pose."""
    return SE2(float(T[0, 3]), float(T[1, 3]), float(np.arctan2(T[1, 0], T[0, 0])))
