"""An estimate of the relative pose: robot 1's pose in robot 0's frame, or the reason why there is none."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from rendezvous.geometry.camera import Image, PinholeCamera
from rendezvous.geometry.se2 import SE2, Array


@dataclass(frozen=True, slots=True, kw_only=True)
class PoseMode:
    """One way to read the image."""

    T_r0_r1: SE2  # θ_relative, the pose of robot 1 in robot 0's frame, on the floor
    covariance: Array  # (3, 3) of the components x [m], y [m], yaw [rad] of `T_r0_r1⁻¹ T_r0_r1_true`
    mass: float  # its probability, in (0, 1]
    T_c_o: Array  # (4, 4) pose of the cuboid in the camera from which it was read
    # Of the Student's t distribution that has this covariance, more than 2; infinite for a normal
    # distribution.
    degrees_of_freedom: float = math.inf

    def __post_init__(self) -> None:
        assert self.covariance.shape == (3, 3), self.covariance.shape
        assert self.T_c_o.shape == (4, 4), self.T_c_o.shape
        assert 0.0 < self.mass <= 1.0, self.mass
        assert self.degrees_of_freedom > 2.0, self.degrees_of_freedom


@dataclass(frozen=True, slots=True, kw_only=True)
class RelativePose:
    """An estimate of the relative pose from one image, or the reason why there is none."""

    # Readings of the image, the most probable first; several where the robot's sides are hard to distinguish,
    # none if the robot was not found: a pose is never made up.
    modes: tuple[PoseMode, ...]
    score: float  # score of the detection, in [0, 1]
    keypoints_px: Array  # (9, 2) the cuboid's points as found in the image, in DOPE's order; NaN if not found
    reason: str = ""  # why there is no pose; '' if there is one

    def __post_init__(self) -> None:
        assert bool(self.modes) == (not self.reason), "an estimate has either a pose or a reason"
        assert self.keypoints_px.shape == (9, 2), self.keypoints_px.shape
        masses = [mode.mass for mode in self.modes]
        assert masses == sorted(masses, reverse=True), masses

    @property
    def found(self) -> bool:
        """Whether there is a pose."""
        return bool(self.modes)

    @property
    def best(self) -> PoseMode:
        """The most probable reading."""
        return self.modes[0]

    @staticmethod
    def not_found(reason: str, *, score: float = 0.0) -> RelativePose:
        """The estimate for an image that does not show the robot well enough."""
        return RelativePose(modes=(), score=score, keypoints_px=np.full((9, 2), np.nan), reason=reason)


class ImagePoseEstimator(Protocol):
    """A method that estimates the relative pose from an image."""

    def __call__(self, image: Image, camera: PinholeCamera, T_r0_c: Array) -> RelativePose:
        """Estimate the pose of robot 1.

        Args:
            image: (H, W, 3) uint8 red, green, blue, undistorted.
            camera: intrinsics of the camera that took it.
            T_r0_c: (4, 4) pose of the camera on robot 0.
        """
