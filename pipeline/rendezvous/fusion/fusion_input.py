"""The system's input: two maps, where their robots stood, and where robot 0 saw robot 1.

The estimates from all images of one sighting are multiplied. Each image gives its modes and, with a small
share, no information (the robot was mistaken, or something else was seen). So images that contradict each
other leave several modes, one without each of them, instead of a mean that none of them supports.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from rendezvous.errors import MapError, SightingError, require_within
from rendezvous.geometry.occupancy_grid import OccupancyGrid
from rendezvous.geometry.se2 import SE2, Array
from rendezvous.pose_estimation.pose_estimate import RelativePose


@dataclass(frozen=True, slots=True, kw_only=True)
class SlamSpread:
    """Standard deviations of each robot's pose in its own map.

    The defaults are about the median error of a lidar SLAM in a building, and what cells of 5 cm allow.
    """

    position_m: float = 0.02
    heading_rad: float = math.radians(0.5)

    def __post_init__(self) -> None:
        require_within(self, position_m=(0.0, 10.0), heading_rad=(0.0, math.pi))

    def covariance(self) -> Array:
        """(3, 3) of x [m], y [m], yaw [rad]."""
        return np.diag([self.position_m**2, self.position_m**2, self.heading_rad**2])


@dataclass(frozen=True, slots=True, kw_only=True)
class FusionInput:
    """Two maps, and where their robots stood when robot 0 saw robot 1.

    Attributes:
        grid_0, grid_1: each robot's map; of any size, resolution and origin.
        T_m0_r0, T_m1_r1: each robot's pose in its own map.
        slam: accuracy of those poses.
    """

    grid_0: OccupancyGrid
    grid_1: OccupancyGrid
    T_m0_r0: SE2
    T_m1_r1: SE2
    slam: SlamSpread = field(default_factory=SlamSpread)

    def __post_init__(self) -> None:
        for number, grid in enumerate((self.grid_0, self.grid_1)):
            if not grid.known().any():
                raise MapError(
                    f"map {number}: none of its {grid.cells.size} cells is known; there is no map to fuse"
                )


OUTLIER_SHARE = 0.02
"""Share of images whose estimate is of something else. A guess on the safe side: calibrated detections are
wrong in less than 1 %."""
OUTLIER_DENSITY = 1.0 / 75.0
"""Density of such an estimate [1 / (m² rad)]: anywhere in 12 m² (what a camera of 55° sees up to 5 m), any
heading."""
MOST_MODES = 16  # most modes kept of a product
NEGLIGIBLE_MASS = 1e-4


@dataclass(frozen=True, slots=True, kw_only=True)
class SightedMode:
    """One way to read a sighting.

    Attributes:
        T_r0_r1: θ_relative, robot 1's pose seen from robot 0.
        covariance: (3, 3) of the components x [m], y [m], yaw [rad] of `T_r0_r1⁻¹ T_r0_r1_true`; None if
            unknown.
        mass: its probability, in (0, 1].
        images: numbers of the images that support it.
        degrees_of_freedom: of the Student's t distribution with this covariance, more than 2; infinite for a
            normal one.
    """

    T_r0_r1: SE2
    covariance: Array | None
    mass: float
    images: tuple[int, ...] = ()
    degrees_of_freedom: float = math.inf


@dataclass(frozen=True, slots=True, kw_only=True)
class SightedPose:
    """The relative pose of robot 1 according to one sighting.

    Attributes:
        modes: the most probable first, at least one.
        score: of the detection, in [0, 1]: the best among the images that support the first mode; None for a
            sighting without images.
        found_in: numbers of the images in which the robot was found.
    """

    modes: tuple[SightedMode, ...]
    score: float | None = None
    found_in: tuple[int, ...] = ()

    @property
    def best(self) -> SightedMode:
        """The most probable mode."""
        return self.modes[0]

    @property
    def contradicted_by(self) -> tuple[int, ...]:
        """Numbers of the images that show the robot elsewhere than the best mode."""
        return tuple(number for number in self.found_in if number not in self.best.images)

    @staticmethod
    def given(T_r0_r1: SE2, covariance: Array | None = None) -> SightedPose:
        """A relative pose that is known by other means than images."""
        return SightedPose(modes=(SightedMode(T_r0_r1=T_r0_r1, covariance=covariance, mass=1.0),))


def sighted_pose(poses: Sequence[RelativePose]) -> SightedPose:
    """Combine the estimates from all images of one sighting, whose errors are taken as independent.

    Raises:
        SightingError: the robot is found in none of the images.
    """
    found = [number for number, pose in enumerate(poses) if pose.found]
    if not found:
        reasons = "; ".join(f"image {number}: {pose.reason}" for number, pose in enumerate(poses))
        raise SightingError(
            f"the robot is found in none of {len(poses)} images ({reasons}); without it there is "
            "nothing to align the maps by: take another image, or give the relative pose"
        )
    modes, mistaken = list[SightedMode](), 1.0
    for number in found:
        modes, mistaken = _times(modes, mistaken, number, poses[number])
    score = max(poses[number].score for number in modes[0].images)
    return SightedPose(modes=tuple(modes), score=score, found_in=tuple(found))


def _times(
    product: list[SightedMode], all_mistaken: float, number: int, pose: RelativePose
) -> tuple[list[SightedMode], float]:
    """Earlier images times one more: the modes, the most probable first, with masses that sum to 1.

    `all_mistaken`, before and after, is the mass of the case that every image is mistaken, on the scale of
    those masses. Masses are normalised after every image: those of some dozens would overflow.
    """
    read = [
        SightedMode(
            T_r0_r1=m.T_r0_r1,
            covariance=m.covariance,
            mass=m.mass,
            images=(number,),
            degrees_of_freedom=m.degrees_of_freedom,
        )
        for m in pose.modes
    ]
    sure, mistaken = 1.0 - OUTLIER_SHARE, OUTLIER_SHARE * OUTLIER_DENSITY
    modes = [
        *(_product(a, b, sure) for a in product for b in read),
        *(replace(a, mass=a.mass * mistaken) for a in product),
        *(replace(b, mass=b.mass * sure * all_mistaken) for b in read),
    ]
    least = NEGLIGIBLE_MASS * sum(mode.mass for mode in modes)
    kept = sorted((mode for mode in modes if mode.mass >= least), key=lambda mode: -mode.mass)[:MOST_MODES]
    total = sum(mode.mass for mode in kept)
    return [replace(mode, mass=mode.mass / total) for mode in kept], all_mistaken * mistaken / total


def _product(a: SightedMode, b: SightedMode, sure: float) -> SightedMode:
    """The product of two normal distributions; its mass is the probability of both agreeing so well.

    With `x` the components of `T_a⁻¹ T`, those of `T_b⁻¹ T` are `J (x - d)`, with d the components of `T_a⁻¹
    T_b`: for close headings the product is exactly normal in x. For t distributions this is nearly true where
    both are dense; the tails of their product fall like those of one with `ν_a + ν_b + 3` degrees of freedom.
    """
    assert a.covariance is not None
    assert b.covariance is not None
    T_a_b = (a.T_r0_r1.inverse() @ b.T_r0_r1).wrapped()
    d, R = T_a_b.as_array(), SE2(0.0, 0.0, T_a_b.yaw_rad).matrix()
    covariance_b = R @ b.covariance @ R.T
    together = a.covariance + covariance_b
    gain = a.covariance @ np.linalg.inv(together)
    x = gain @ d
    covariance = a.covariance - gain @ a.covariance
    back = SE2(0.0, 0.0, -float(x[2])).matrix()
    log_density = -0.5 * (d @ np.linalg.solve(together, d) + np.linalg.slogdet(2.0 * math.pi * together)[1])
    return SightedMode(
        T_r0_r1=(a.T_r0_r1 @ SE2.from_array(x)).wrapped(),
        covariance=back @ (0.5 * (covariance + covariance.T)) @ back.T,
        mass=a.mass * b.mass * sure * math.exp(log_density),
        images=(*a.images, *b.images),
        degrees_of_freedom=a.degrees_of_freedom + b.degrees_of_freedom + 3.0,
    )
