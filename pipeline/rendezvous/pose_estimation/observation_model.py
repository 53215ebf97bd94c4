"""The observation model: where the cuboid of robot 1 appears in the image of a camera on robot 0.

A state has six numbers: x [m], y [m] and yaw [rad] of `T_r0_r1`, and the camera's deviation from its nominal
place on a level robot 0: height [m] and a rotation about its own position, whose rotation vector has
components x and y in r0 [rad]. Any `T_c_o` is exactly one state; on a flat floor the last three are small.

Legend: M states, 9 points of the cuboid in DOPE's order.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rendezvous.geometry.camera import PinholeCamera, se3_from_se2
from rendezvous.geometry.cuboid import Vec3, cuboid_points
from rendezvous.geometry.se2 import SE2, Array

HEIGHT_SIGMA_M, TILT_SIGMA_RAD = 0.004, 0.015
"""Standard deviations of the camera's height and tilt on a level floor. Robots on wheels were seen to deviate
by 3 mm and 0.012 rad; carpets and thresholds add some."""
_NEAREST_M = 0.02
_SMALL = 1e-12


@dataclass(frozen=True, slots=True, kw_only=True)
class SeenRobot:
    """The robot to be found in the image."""

    size_m: Vec3  # sides of its cuboid along the axes of o
    T_r1_o: Array  # (4, 4) pose of the cuboid on it

    def points_r1(self) -> Array:
        """(9, 3) [m] the cuboid's points in r1."""
        points: Array = cuboid_points(self.size_m) @ self.T_r1_o[:3, :3].T + self.T_r1_o[:3, 3]
        return points


@dataclass(frozen=True, slots=True, kw_only=True)
class ObservationModel:
    """Everything known before the image is read."""

    camera: PinholeCamera  # intrinsics
    T_r0_c: Array  # (4, 4) pose of the camera on a level robot 0
    robot: SeenRobot  # the robot to be found

    def points_c(self, states_M6: Array) -> Array:
        """(M, 9, 3) [m] the cuboid's points in the camera."""
        x, y, yaw, height, *_ = states_M6.T
        q = self.robot.points_r1()
        c, s = np.cos(yaw)[:, None], np.sin(yaw)[:, None]
        p_r0 = np.stack(
            [
                x[:, None] + c * q[:, 0] - s * q[:, 1],
                y[:, None] + s * q[:, 0] + c * q[:, 1],
                np.broadcast_to(q[:, 2], (len(states_M6), 9)),
            ],
            axis=2,
        )
        p_r0 -= self.T_r0_c[:3, 3]
        p_r0[..., 2] -= height[:, None]
        points: Array = p_r0 @ (tilt_rotations(states_M6[:, 4:]) @ self.T_r0_c[:3, :3])
        return points

    def project(self, states_M6: Array) -> Array:
        """(M, 9, 2) [px] image of the cuboid's points; points behind the camera land far outside."""
        p_c = self.points_c(states_M6)
        z = np.maximum(p_c[..., 2], _NEAREST_M)
        u = self.camera.fx_px * p_c[..., 0] / z + self.camera.cx_px
        v = self.camera.fy_px * p_c[..., 1] / z + self.camera.cy_px
        return np.stack([u, v], axis=2)

    def jacobian(self, states_M6: Array) -> Array:
        """(M, 9, 2, 6) derivative of `project`, by central differences."""
        step = 1e-5
        moved = states_M6[:, None, None] + step * np.stack([np.eye(6), -np.eye(6)])
        uv = self.project(moved.reshape(-1, 6)).reshape(len(states_M6), 2, 6, 9, 2)
        slopes: Array = np.moveaxis(uv[:, 0] - uv[:, 1], 1, 3) / (2.0 * step)
        return slopes

    def T_c_o(self, state_6: Array) -> Array:
        """(4, 4) pose of the cuboid in the camera."""
        T_r0_c = self.T_r0_c.copy()
        T_r0_c[:3, :3] = tilt_rotations(state_6[None, 4:])[0] @ T_r0_c[:3, :3]
        T_r0_c[2, 3] += state_6[3]
        T_r0_r1 = se3_from_se2(SE2.from_array(state_6[:3]))
        pose: Array = np.linalg.inv(T_r0_c) @ T_r0_r1 @ self.robot.T_r1_o
        return pose

    def state(self, T_c_o: Array) -> Array:
        """(6,) inverse of `T_c_o`."""
        T = self.T_r0_c @ T_c_o @ np.linalg.inv(self.robot.T_r1_o)
        # The shortest rotation that makes robot 1 upright.
        axis = np.array([T[1, 2], -T[0, 2], 0.0])
        sine, cosine = float(np.linalg.norm(axis)), float(T[2, 2])
        tilt = axis / max(sine, _SMALL) * np.arctan2(sine, cosine)
        upright, camera_r0 = tilt_rotations(tilt[None, :2])[0], self.T_r0_c[:3, 3]
        x, y, z = upright @ (T[:3, 3] - camera_r0) + camera_r0
        R = upright @ T[:3, :3]
        return np.array([x, y, np.arctan2(R[1, 0], R[0, 0]), -z, tilt[0], tilt[1]])


def tilt_rotations(tilt_M2: Array) -> Array:
    """(M, 3, 3) rotations by rotation vectors (x, y, 0) [rad]; twice as fast as SciPy's for up to 500."""
    angle = np.maximum(np.linalg.norm(tilt_M2, axis=1), _SMALL)
    x, y = (tilt_M2 / angle[:, None]).T
    c, s = np.cos(angle), np.sin(angle)
    # A tilt of zero has no axis, but to first order it is the identity all the same.
    return np.stack(
        [
            np.stack([c + x * x * (1 - c), x * y * (1 - c), y * s], axis=1),
            np.stack([x * y * (1 - c), c + y * y * (1 - c), -x * s], axis=1),
            np.stack([-y * s, x * s, c], axis=1),
        ],
        axis=1,
    )
