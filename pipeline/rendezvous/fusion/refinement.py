"""The frame error as the sighting alone has it, and the search for it in the maps, given that prior.

Let A be the pose of robot 1 in map 0 by T̃ (heading φ). If the sighting errs by δ, so that T_r0_r1 δ is the
true pose, then `T̃ T⁻¹ = A δ⁻¹ A⁻¹` and `θ_v = R_φ δ⁻¹ R_φ⁻¹`: θ_v spreads as δ does, turned by φ. Another
mode of the sighting, D away from the one in T̃, gives `R_φ (D δ)⁻¹ R_φ⁻¹`: normal around `R_φ D⁻¹ R_φ⁻¹`.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import TYPE_CHECKING

import numpy as np

from rendezvous.alignment.estimate import Estimate, FrameErrorEstimator
from rendezvous.alignment.frame_error import ellipsoid_probability, nees
from rendezvous.alignment.window import DEFAULT_SEARCH, SearchRange, map_window
from rendezvous.baselines.correlative import CorrelativeSearch
from rendezvous.fusion.fusion_input import OUTLIER_SHARE, FusionInput, SightedMode, SightedPose, SlamSpread
from rendezvous.geometry.se2 import SE2, Array
from rendezvous.models.posterior import Gaussian

if TYPE_CHECKING:  # fusing without the matcher needs no PyTorch
    from rendezvous.models.matcher_estimator import MatcherEstimator

OUTLIER_SIGMAS = (1.0, 1.0, math.radians(90.0))
"""Standard deviations [m, m, rad] of the frame error if the sighting is of something else: the paper's
range in x and y, and nearly any heading."""
WIDEST = SearchRange(xy_m=4.0, yaw_rad=math.pi)  # as far as a search makes sense in a window of 19 m
NARROWEST = SearchRange(xy_m=0.3, yaw_rad=math.radians(5.0))  # a search always has some room: maps drift
SEARCH_SIGMAS = 3.5  # standard deviations that a search reaches


@dataclass(frozen=True, slots=True, kw_only=True)
class FrameErrorPrior:
    """The distribution of the frame error θ_v according to the sighting."""

    # One for each mode of the sighting. A search takes them as normal, with their covariance.
    modes: tuple[Gaussian, ...]
    outlier: Gaussian  # the remaining part, if the sighting is of something else
    degrees_of_freedom: tuple[float, ...]  # of the t distributions of the modes; infinite for normal ones

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
    """The prior of θ_v for the T̃ of the sighting's best mode; None if its covariance is unknown."""
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


class Refinement(StrEnum):
    """How T̃ is refined by the maps.

    NONE: not at all. LEARNED: by the matcher, over its whole default search, whatever the sighting's
    covariance. CORRELATIVE: by correlative search, as far as the sighting's covariance reaches. AUTO: by the
    matcher, whose posterior is multiplied by the sighting's prior; its search is always wide, because a small
    share of that prior is kept for sightings of something else.
    """

    NONE = "none"
    LEARNED = "learned"
    CORRELATIVE = "correlative"
    AUTO = "auto"

    @property
    def needs_matcher(self) -> bool:
        """Whether it uses the learned matcher."""
        return self in (Refinement.LEARNED, Refinement.AUTO)


Refiner = Callable[[FrameErrorPrior | None], tuple[FrameErrorEstimator, SearchRange]]
"""Given the prior, or None, returns the estimator of the frame error and how far it searches."""


def correlative_refiner(prior: FrameErrorPrior | None) -> tuple[FrameErrorEstimator, SearchRange]:
    """Correlative search; it takes no prior, so it goes only as far as the sighting's modes reach."""
    search = DEFAULT_SEARCH if prior is None else prior.search(with_outlier=False)
    return CorrelativeSearch(search=search), search


def matcher_refiner(matcher: MatcherEstimator, *, with_prior: bool) -> Refiner:
    """The matcher; with the prior, where there is one, it searches all of it and multiplies it in."""

    def refiner(prior: FrameErrorPrior | None) -> tuple[FrameErrorEstimator, SearchRange]:
        if prior is None or not with_prior:
            return replace(matcher, search=DEFAULT_SEARCH, priors=()), DEFAULT_SEARCH
        search = prior.search(with_outlier=True)
        return replace(matcher, search=search, priors=prior.parts), search

    return refiner


WINDOW_TURN_RAD = math.radians(22.5)
"""Drawn into a window along its own cells, all of a map's walls move the same way, by up to half a cell. In a
window turned by this much, each moves its own way, which halves the error of the estimate."""
EDGE_M, EDGE_RAD = 0.1, math.radians(1.0)  # this close to its search's edge, an estimate may lie beyond


@dataclass(frozen=True, slots=True, kw_only=True)
class RefinedAlignment:
    """The frame error of T̃ according to the maps."""

    estimate: Estimate  # θ̂_v and its covariance along v's axes; or the reason there is none
    search: SearchRange  # how far the method searched
    at_edge: bool  # the estimate lies at the edge of that search


def refined(
    given: FusionInput, T_m0_m1: SE2, T_m0_v: SE2, refiner: Refiner, prior: FrameErrorPrior | None
) -> RefinedAlignment:
    """Estimate the frame error of an initial alignment, in a window that is turned against both maps.

    The result is in `T_m0_v`, the window's centre with the axes of m0; so is the sighting's prior.
    """
    yaw_rad = _window_yaw(given, T_m0_m1)
    R = SE2(0.0, 0.0, yaw_rad)
    estimator, search = refiner(None if prior is None else prior.turned(yaw_rad))
    window = map_window(given.grid_0, given.grid_1, T_m0_m1, T_m0_v @ R, T_m0_r0=given.T_m0_r0)
    found = estimator(window)
    if found.theta is None:
        return RefinedAlignment(estimate=found, search=search, at_edge=False)
    covariance = None if found.covariance is None else R.matrix() @ found.covariance @ R.matrix().T
    theta = (R @ found.theta @ R.inverse()).wrapped()
    return RefinedAlignment(
        estimate=replace(found, theta=theta, covariance=covariance),
        search=search,
        at_edge=_at_edge(found.theta, search),
    )


def _window_yaw(given: FusionInput, T_m0_m1: SE2) -> float:
    """A yaw of the window in m0 that lies along the cells of neither map."""
    along_0 = given.grid_0.T_m_g.yaw_rad
    along_1 = (T_m0_m1 @ given.grid_1.T_m_g).yaw_rad
    candidates = along_0 + WINDOW_TURN_RAD, along_0 - WINDOW_TURN_RAD
    # Cells look the same after a quarter turn.
    return max(candidates, key=lambda yaw_rad: abs(math.remainder(yaw_rad - along_1, 0.5 * math.pi)))


def _at_edge(theta: SE2, search: SearchRange) -> bool:
    all_around = search.yaw_rad >= math.pi - EDGE_RAD
    return max(abs(theta.x_m), abs(theta.y_m)) > search.xy_m - EDGE_M or (
        abs(theta.yaw_rad) > search.yaw_rad - EDGE_RAD and not all_around
    )
