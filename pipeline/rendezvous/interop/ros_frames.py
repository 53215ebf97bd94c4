"""Frames of a ROS bag: what its transforms say of how the lidar sits on the robot, and of where that went."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from rendezvous.errors import LogError
from rendezvous.geometry.se2 import Array

_STILL = 1e-3  # transforms that differ by less are one that is sent again and again
_LEAST_LEVEL = math.cos(math.radians(3.0))


@dataclass(slots=True)
class Frames:
    """All transforms of a bag, by child frame."""

    parents: dict[str, str] = field(default_factory=dict)
    # stamps_s: of each transform, its own and when it was received; transforms: (4, 4) pose in the parent.
    stamps_s: dict[str, list[tuple[float, float]]] = field(default_factory=dict)
    transforms: dict[str, list[Array]] = field(default_factory=dict)

    def add(self, parent: str, child: str, stamps_s: tuple[float, float], T_parent_child: Array) -> None:
        """Add one transform; a frame has one parent, the last that is named."""
        parent, child = parent.lstrip("/"), child.lstrip("/")
        if self.parents.get(child) != parent:
            self.parents[child] = parent
            self.stamps_s[child], self.transforms[child] = [], []
        self.stamps_s[child].append(stamps_s)
        self.transforms[child].append(T_parent_child)

    def moves(self, child: str) -> bool:
        """Whether a frame moves in its parent."""
        of_child = np.array(self.transforms[child])
        return bool(np.abs(of_child - of_child[0]).max() > _STILL)

    def fixed_to(self, frame: str) -> dict[str, Array]:
        """Frames above this one up to the first that moves, and the pose of `frame` in each."""
        found, T = {frame: np.eye(4)}, np.eye(4)
        while frame in self.parents and not self.moves(frame):
            T = self.transforms[frame][0] @ T
            frame = self.parents[frame]
            if frame in found:
                break
            found[frame] = T
        return found

    def moving_base(self, frame: str) -> str | None:
        """The frame that a sensor's frame is fixed to and that moves in its own parent; None without one."""
        top = list(self.fixed_to(frame))[-1]
        return top if top in self.parents else None


def mounting(frames: Frames, base: str, sensor: str, source: str) -> Array:
    """(4, 4) pose of the sensor's frame on the robot.

    Raises:
        LogError: no fixed transforms lead from one to the other.
    """
    of_sensor, of_base = frames.fixed_to(sensor), frames.fixed_to(base)
    for frame, T_frame_sensor in of_sensor.items():
        if frame in of_base:
            return np.asarray(np.linalg.inv(of_base[frame]) @ T_frame_sensor)
    raise LogError(
        f"{source}: no fixed transforms from {base!r} to the lidar's {sensor!r} in /tf_static or /tf; "
        "--lidar-pose says how it sits on the robot"
    )


def level_bearings(angles_rad: Array, T_r_l: Array, source: str) -> Array:
    """(B,) the beams' directions from the robot's heading; a lidar upside down turns the other way.

    Raises:
        LogError: the lidar is tilted, so that it does not scan in a level plane.
    """
    if abs(T_r_l[2, 2]) < _LEAST_LEVEL:
        tilt_deg = math.degrees(math.acos(min(1.0, abs(float(T_r_l[2, 2])))))
        raise LogError(
            f"{source}: its lidar is tilted by {tilt_deg:.0f}°; must be level, upright or upside down"
        )
    beams = np.stack([np.cos(angles_rad), np.sin(angles_rad), np.zeros_like(angles_rad)])
    x, y, _ = T_r_l[:3, :3] @ beams
    return np.asarray(np.unwrap(np.arctan2(y, x)))


def matrix_of(xyz_m: tuple[float, float, float], quat_xyzw: tuple[float, float, float, float]) -> Array:
    """(4, 4) of a translation and a rotation; a quaternion of zeros, as some drivers send, is no rotation."""
    T = np.eye(4)
    T[:3, 3] = xyz_m
    q = np.array(quat_xyzw)
    norm = float(np.linalg.norm(q))
    if norm > 1e-6:
        x, y, z, w = q / norm
        T[:3, :3] = [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    return T


def planar(T: Array) -> Array:
    """(3,) x, y, yaw of a pose (4, 4) on the floor."""
    return np.array([T[0, 3], T[1, 3], math.atan2(T[1, 0], T[0, 0])])
