"""How the frame error is looked for, given what the sighting says of it."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import TYPE_CHECKING

from rendezvous.alignment.estimate import Estimate, FrameErrorEstimator
from rendezvous.alignment.window import DEFAULT_SEARCH, SearchRange, map_window
from rendezvous.baselines.correlative import CorrelativeSearch
from rendezvous.fusion.meeting import Meeting
from rendezvous.fusion.prior import FrameErrorPrior
from rendezvous.geometry.se2 import SE2

if TYPE_CHECKING:  # so that whoever does without the matcher needs no PyTorch
    from rendezvous.models.matcher_estimator import MatcherEstimator


class Refinement(StrEnum):
    """How T̃ is refined by the maps.

    NONE: not at all. LEARNED: by the matcher, over its whole default search, whatever the sighting says of
    its error. CORRELATIVE: by correlative search, as far as the sighting's covariance reaches. AUTO: by the
    matcher, whose posterior is multiplied by what the sighting says; its search is wide whatever that says,
    for a small share of it is kept for sightings of something else.
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
"""Gives the estimator of the frame error, and how far it searches; no prior: nothing is known of it."""


def correlative_refiner(prior: FrameErrorPrior | None) -> tuple[FrameErrorEstimator, SearchRange]:
    """Correlative search; it knows no prior, so it goes only as far as the sighting's modes reach."""
    search = DEFAULT_SEARCH if prior is None else prior.search(with_outlier=False)
    return CorrelativeSearch(search=search), search


def matcher_refiner(matcher: MatcherEstimator, *, with_prior: bool) -> Refiner:
    """The matcher; with the prior, where there is one, it searches all of that and multiplies it in."""

    def refiner(prior: FrameErrorPrior | None) -> tuple[FrameErrorEstimator, SearchRange]:
        if prior is None or not with_prior:
            return replace(matcher, search=DEFAULT_SEARCH, priors=()), DEFAULT_SEARCH
        search = prior.search(with_outlier=True)
        return replace(matcher, search=search, priors=prior.parts), search

    return refiner


WINDOW_TURN_RAD = math.radians(22.5)
"""Drawn into a window along its own cells, all of a map's walls move the same way, by up to half a cell. In a
window that is turned by this against it, each moves its own way: that halves the error of the estimate."""

EDGE_M, EDGE_RAD = 0.1, math.radians(1.0)
"""An estimate so close to the end of its search may lie beyond it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Refined:
    """The frame error of T̃ as the maps have it.

    Attributes:
        estimate: θ̂_w in the window frame w, its covariance that of what it leaves along w's axes; or no θ.
        search: how far it was looked for.
        at_edge: whether it lies at the end of that search.
    """

    estimate: Estimate
    search: SearchRange
    at_edge: bool


def refined(
    meeting: Meeting, T_m0_m1: SE2, T_m0_w: SE2, refiner: Refiner, prior: FrameErrorPrior | None
) -> Refined:
    """Look for the frame error of an initial alignment.

    Args:
        meeting: maps and poses.
        T_m0_m1: T̃.
        T_m0_w: the window's centre, with the axes of m0.
        refiner: gives the method.
        prior: what the sighting says, in w; None if it says nothing of its error.
    """
    yaw_rad = _window_yaw(meeting, T_m0_m1)
    R = SE2(0.0, 0.0, yaw_rad)
    estimator, search = refiner(None if prior is None else prior.turned(yaw_rad))
    window = map_window(meeting.grid_0, meeting.grid_1, T_m0_m1, T_m0_w @ R, T_m0_r0=meeting.T_m0_r0)
    found = estimator(window)
    if found.theta is None:
        return Refined(estimate=found, search=search, at_edge=False)
    covariance = None if found.covariance is None else R.matrix() @ found.covariance @ R.matrix().T
    theta = (R @ found.theta @ R.inverse()).wrapped()
    return Refined(
        estimate=replace(found, theta=theta, covariance=covariance),
        search=search,
        at_edge=_at_edge(found.theta, search),
    )


def _window_yaw(meeting: Meeting, T_m0_m1: SE2) -> float:
    """A yaw of the window in m0 that lies along the cells of neither map."""
    along_0 = meeting.grid_0.T_m_g.yaw_rad
    along_1 = (T_m0_m1 @ meeting.grid_1.T_m_g).yaw_rad
    candidates = along_0 + WINDOW_TURN_RAD, along_0 - WINDOW_TURN_RAD
    # Cells look the same after a quarter turn.
    return max(candidates, key=lambda yaw_rad: abs(math.remainder(yaw_rad - along_1, 0.5 * math.pi)))


def _at_edge(theta: SE2, search: SearchRange) -> bool:
    all_around = search.yaw_rad >= math.pi - EDGE_RAD
    return max(abs(theta.x_m), abs(theta.y_m)) > search.xy_m - EDGE_M or (
        abs(theta.yaw_rad) > search.yaw_rad - EDGE_RAD and not all_around
    )
