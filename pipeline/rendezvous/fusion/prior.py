"""What a sighting says of the frame error before the maps are looked at.

Let A be the pose of robot 1 in map 0 by T̃ (translation C, heading φ). With the sighting's error δ, T_r0_r1 δ
being the true pose, `T̃ T⁻¹ = A δ⁻¹ A⁻¹`, so that `θ_w = R_φ δ⁻¹ R_φ⁻¹`: the spread of θ_w is that of δ,
turned by φ. For another mode, D away from the one in T̃, it is `R_φ (D δ)⁻¹ R_φ⁻¹`: normal around
`R_φ D⁻¹ R_φ⁻¹`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from rendezvous.alignment.spread import ellipsoid_probability, nees
from rendezvous.alignment.window import SearchRange
from rendezvous.errors import require_within
from rendezvous.fusion.sighted_pose import OUTLIER_SHARE, SightedMode, SightedPose
from rendezvous.geometry.se2 import SE2, Array
from rendezvous.models.posterior import Gaussian

OUTLIER_SIGMAS = (1.0, 1.0, math.radians(90.0))
"""Standard deviations [m, m, rad] of the frame error where the sighting is of something else: the paper's
range in x and y, and nearly any heading."""

WIDEST = SearchRange(xy_m=4.0, yaw_rad=math.pi)
"""As far as a search makes sense in a window of 19 m."""

NARROWEST = SearchRange(xy_m=0.3, yaw_rad=math.radians(5.0))
"""A search always has some room: maps drift."""

SIGMAS = 3.5
"""A search reaches so many standard deviations."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SlamSpread:
    """How well each robot knows where it stands in its own map: standard deviations.

    The defaults are about the median error of a lidar SLAM in a building, and what a cell of 5 cm allows.
    """

    position_m: float = 0.02
    heading_rad: float = math.radians(0.5)

    def __post_init__(self) -> None:
        require_within(self, position_m=(0.0, 10.0), heading_rad=(0.0, math.pi))

    def covariance(self) -> Array:
        """(3, 3) of x [m], y [m], yaw [rad]."""
        return np.diag([self.position_m**2, self.position_m**2, self.heading_rad**2])


@dataclass(frozen=True, slots=True, kw_only=True)
class FrameErrorPrior:
    """The frame error θ_w as the sighting has it.

    Attributes:
        modes: one for each of the sighting's. A search takes them as normal, of the covariance they have.
        outlier: what is left if the sighting is of something else.
        degrees_of_freedom: of the t distributions that the modes are; infinite: normal.
    """

    modes: tuple[Gaussian, ...]
    outlier: Gaussian
    degrees_of_freedom: tuple[float, ...]

    def __post_init__(self) -> None:
        assert len(self.modes) == len(self.degrees_of_freedom), self.degrees_of_freedom

    @property
    def parts(self) -> tuple[Gaussian, ...]:
        """All of the mixture."""
        return (*self.modes, self.outlier)

    def search(self, *, with_outlier: bool) -> SearchRange:
        """The search that reaches all modes; with the outlier, that whole part as well."""
        searches = [part.search(sigmas=SIGMAS) for part in (self.parts if with_outlier else self.modes)]
        return SearchRange(
            xy_m=min(WIDEST.xy_m, max(NARROWEST.xy_m, *(s.xy_m for s in searches))),
            yaw_rad=min(WIDEST.yaw_rad, max(NARROWEST.yaw_rad, *(s.yaw_rad for s in searches))),
        )

    def turned(self, yaw_rad: float) -> FrameErrorPrior:
        """The same, seen from a window frame that is turned by this angle."""
        R = SE2(0.0, 0.0, yaw_rad)
        back = R.inverse().matrix()

        def turned(part: Gaussian) -> Gaussian:
            mean = (R.inverse() @ part.mean @ R).wrapped()
            return replace(part, mean=mean, covariance=back @ part.covariance @ back.T)

        return replace(self, modes=tuple(map(turned, self.modes)), outlier=turned(self.outlier))

    def surprise(self, theta: SE2, covariance: Array) -> float:
        """How improbable the nearest mode is, given an estimate with its own covariance: 1 - p, in [0, 1].

        Near 1, the estimate contradicts the sighting.
        """
        errors = [(mode.mean.inverse() @ theta).wrapped().as_array() for mode in self.modes]
        distances = nees(np.array(errors), np.array([mode.covariance + covariance for mode in self.modes]))
        return float(ellipsoid_probability(distances, np.array(self.degrees_of_freedom)).min())


def frame_error_prior(sighting: SightedPose, T_m0_r0: SE2, *, slam: SlamSpread) -> FrameErrorPrior | None:
    """The prior of θ_w for T̃ made of the sighting's best mode; None if its covariance is not known.

    Args:
        sighting: of robot 1.
        T_m0_r0: where robot 0 stood.
        slam: how well both robots know where they stand.
    """
    if sighting.best.covariance is None:
        return None
    phi_rad = T_m0_r0.yaw_rad + sighting.best.T_r0_r1.yaw_rad
    parts = [_part(mode, sighting.best.T_r0_r1, phi_rad, slam) for mode in sighting.modes]
    outlier = Gaussian(
        mean=SE2.identity(), covariance=np.diag(np.square(OUTLIER_SIGMAS)), weight=OUTLIER_SHARE
    )
    return FrameErrorPrior(
        modes=tuple(parts),
        outlier=outlier,
        degrees_of_freedom=tuple(mode.degrees_of_freedom for mode in sighting.modes),
    )


def _part(mode: SightedMode, T_r0_best: SE2, phi_rad: float, slam: SlamSpread) -> Gaussian:
    """What one mode says of θ_w."""
    R = SE2(0.0, 0.0, phi_rad)
    R_D = R @ T_r0_best.inverse() @ mode.T_r0_r1
    mean = (R @ R_D.inverse()).wrapped()
    turned = adjoint(R_D) @ _with_slam(mode, slam) @ adjoint(R_D).T
    return Gaussian(mean=mean, covariance=turned, weight=(1.0 - OUTLIER_SHARE) * mode.mass)


def _with_slam(mode: SightedMode, slam: SlamSpread) -> Array:
    """(3, 3) covariance of the sighting, with the errors of both robots' own poses carried to robot 1."""
    assert mode.covariance is not None
    own = slam.covariance()
    carried = adjoint(mode.T_r0_r1.inverse())
    return mode.covariance + carried @ own @ carried.T + own


def adjoint(T: SE2) -> Array:
    """(3, 3) that makes the components of a small motion δ those of `T δ T⁻¹`."""
    c, s = math.cos(T.yaw_rad), math.sin(T.yaw_rad)
    return np.array([[c, -s, T.y_m], [s, c, -T.x_m], [0.0, 0.0, 1.0]])
