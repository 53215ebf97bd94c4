"""The search for the frame error, given the sighting's prior."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import TYPE_CHECKING

from rendezvous.alignment.estimate import Estimate, FrameErrorEstimator
from rendezvous.alignment.window import DEFAULT_SEARCH, SearchRange, map_window
from rendezvous.baselines.correlative import CorrelativeSearch
from rendezvous.fusion.fusion_input import FusionInput
from rendezvous.fusion.prior import FrameErrorPrior
from rendezvous.geometry.se2 import SE2

if TYPE_CHECKING:  # fusing without the matcher needs no PyTorch
    from rendezvous.models.matcher_estimator import MatcherEstimator


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

EDGE_M, EDGE_RAD = 0.1, math.radians(1.0)
"""An estimate this close to the edge of its search may lie beyond it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RefinedAlignment:
    """The frame error of T̃ according to the maps.

    Attributes:
        estimate: θ̂_v and its covariance along v's axes; or the reason there is none.
        search: how far the method searched.
        at_edge: the estimate lies at the edge of that search.
    """

    estimate: Estimate
    search: SearchRange
    at_edge: bool


def refined(
    given: FusionInput, T_m0_m1: SE2, T_m0_v: SE2, refiner: Refiner, prior: FrameErrorPrior | None
) -> RefinedAlignment:
    """Estimate the frame error of an initial alignment, in a window that is turned against both maps.

    Args:
        given: maps and poses.
        T_m0_m1: T̃.
        T_m0_v: the window's centre, with the axes of m0; the result is in this frame.
        refiner: gives the method.
        prior: the sighting's, in v; None without a covariance.
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
