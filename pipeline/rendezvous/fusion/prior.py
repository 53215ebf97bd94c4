"""The frame error as the sighting alone has it, before the maps are compared.

Let A be the pose of robot 1 in map 0 by T̃ (heading φ). If the sighting errs by δ, so that T_r0_r1 δ is the
true pose, then `T̃ T⁻¹ = A δ⁻¹ A⁻¹` and `θ_v = R_φ δ⁻¹ R_φ⁻¹`: θ_v spreads as δ does, turned by φ. Another
mode of the sighting, D away from the one in T̃, gives `R_φ (D δ)⁻¹ R_φ⁻¹`: normal around `R_φ D⁻¹ R_φ⁻¹`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from rendezvous.alignment.spread import ellipsoid_probability, nees
from rendezvous.alignment.window import SearchRange
from rendezvous.fusion.fusion_input import SlamSpread
from rendezvous.fusion.sighted_pose import OUTLIER_SHARE, SightedMode, SightedPose
from rendezvous.geometry.se2 import SE2, Array
from rendezvous.models.posterior import Gaussian

OUTLIER_SIGMAS = (1.0, 1.0, math.radians(90.0))
"""Standard deviations [m, m, rad] of the frame error if the sighting is of something else: the paper's
range in x and y, and nearly any heading."""

WIDEST = SearchRange(xy_m=4.0, yaw_rad=math.pi)  # as far as a search makes sense in a window of 19 m
NARROWEST = SearchRange(xy_m=0.3, yaw_rad=math.radians(5.0))  # a search always has some room: maps drift
SEARCH_SIGMAS = 3.5  # standard deviations that a search reaches


@dataclass(frozen=True, slots=True, kw_only=True)
class FrameErrorPrior:
    """The distribution of the frame error θ_v according to the sighting.

    Attributes:
        modes: one for each mode of the sighting. A search takes them as normal, with their covariance.
        outlier: the remaining part, if the sighting is of something else.
        degrees_of_freedom: of the t distributions of the modes; infinite for normal ones.
    """

    modes: tuple[Gaussian, ...]
    outlier: Gaussian
    degrees_of_freedom: tuple[float, ...]

    def __post_init__(self) -> None:
        assert len(self.modes) == len(self.degrees_of_freedom), self.degrees_of_freedom

    @property
    def parts(self) -> tuple[Gaussian, ...]:
        """The whole mixture."""
        return (*self.modes, self.outlier)

    def search(self, *, with_outlier: bool) -> SearchRange:
        """The search that reaches all modes and, if asked, the outlier part."""
        parts = self.parts if with_outlier else self.modes
        searches = [part.search(sigmas=SEARCH_SIGMAS) for part in parts]
        return SearchRange(
            xy_m=min(WIDEST.xy_m, max(NARROWEST.xy_m, *(s.xy_m for s in searches))),
            yaw_rad=min(WIDEST.yaw_rad, max(NARROWEST.yaw_rad, *(s.yaw_rad for s in searches))),
        )

    def turned(self, yaw_rad: float) -> FrameErrorPrior:
        """The same prior in a window frame that is turned by this angle."""
        R = SE2(0.0, 0.0, yaw_rad)
        back = R.inverse().matrix()

        def turned(part: Gaussian) -> Gaussian:
            mean = (R.inverse() @ part.mean @ R).wrapped()
            return replace(part, mean=mean, covariance=back @ part.covariance @ back.T)

        return replace(self, modes=tuple(map(turned, self.modes)), outlier=turned(self.outlier))

    def surprise(self, theta: SE2, covariance: Array) -> float:
        """1 - p, in [0, 1], with p the probability of an estimate this far from its nearest mode.

        Near 1, the estimate (with its own covariance) contradicts the sighting.
        """
        errors = [(mode.mean.inverse() @ theta).wrapped().as_array() for mode in self.modes]
        distances = nees(np.array(errors), np.array([mode.covariance + covariance for mode in self.modes]))
        return float(ellipsoid_probability(distances, np.array(self.degrees_of_freedom)).min())


def frame_error_prior(sighting: SightedPose, T_m0_r0: SE2, *, slam: SlamSpread) -> FrameErrorPrior | None:
    """The prior of θ_v for the T̃ of the sighting's best mode; None if its covariance is unknown.

    Args:
        sighting: of robot 1.
        T_m0_r0: where robot 0 stood.
        slam: accuracy of both robots' own poses.
    """
    if sighting.best.covariance is None:
        return None
    phi_rad = T_m0_r0.yaw_rad + sighting.best.T_r0_r1.yaw_rad
    return FrameErrorPrior(
        modes=tuple(_part(mode, sighting.best.T_r0_r1, phi_rad, slam) for mode in sighting.modes),
        outlier=Gaussian(
            mean=SE2.identity(), covariance=np.diag(np.square(OUTLIER_SIGMAS)), weight=OUTLIER_SHARE
        ),
        degrees_of_freedom=tuple(mode.degrees_of_freedom for mode in sighting.modes),
    )


def _part(mode: SightedMode, T_r0_best: SE2, phi_rad: float, slam: SlamSpread) -> Gaussian:
    """The distribution of θ_v if this mode is the right one."""
    R = SE2(0.0, 0.0, phi_rad)
    R_D = R @ T_r0_best.inverse() @ mode.T_r0_r1
    mean = (R @ R_D.inverse()).wrapped()
    turned = adjoint(R_D) @ _with_slam(mode, slam) @ adjoint(R_D).T
    return Gaussian(mean=mean, covariance=turned, weight=(1.0 - OUTLIER_SHARE) * mode.mass)


def _with_slam(mode: SightedMode, slam: SlamSpread) -> Array:
    """(3, 3) covariance of the sighting, plus the errors of both robots' own poses carried to robot 1."""
    assert mode.covariance is not None
    own = slam.covariance()
    carried = adjoint(mode.T_r0_r1.inverse())
    return mode.covariance + carried @ own @ carried.T + own


def adjoint(T: SE2) -> Array:
    """(3, 3) that maps the components of a small motion δ to those of `T δ T⁻¹`."""
    c, s = math.cos(T.yaw_rad), math.sin(T.yaw_rad)
    return np.array([[c, -s, T.y_m], [s, c, -T.x_m], [0.0, 0.0, 1.0]])
