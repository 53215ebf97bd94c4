"""Whether a method knows how far off it is: covariances, densities and warnings against the errors."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rendezvous.alignment.spread import ellipsoid_probability, log_density, nees
from rendezvous.evaluation.frame_error.estimates import Outcomes
from rendezvous.evaluation.statistics import Interval, wilson_interval
from rendezvous.geometry.occupancy_grid import Mask

LEVELS = (0.5, 0.9, 0.95)
"""Probabilities of the ellipsoids whose coverage is told."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Calibration:
    """How well a method's covariances tell its errors, over the estimates that have one.

    Attributes:
        count: how many.
        coverage: by `LEVELS`, share of errors inside the ellipsoid of that probability.
        nees_mean, nees_median: the mean is 3 if covariances are right; the median is 2.37 then of normal
            errors, and less of heavy tails.
        spread_nll: mean negative log density of the true frame error under the normal or t distribution.
        posterior_nll: the same under the method's own posterior; None if it has none.
    """

    count: int
    coverage: tuple[Interval, ...]
    nees_mean: float
    nees_median: float
    spread_nll: float
    posterior_nll: float | None


def calibration(outcomes: Outcomes, chosen: Mask) -> Calibration | None:
    """Of the chosen (N,) outcomes, those with a covariance; None if there are none."""
    chosen = chosen & ~outcomes.failed & np.isfinite(outcomes.covariance).all(axis=(1, 2))
    if not chosen.any():
        return None
    error, covariance = outcomes.error[chosen], outcomes.covariance[chosen]
    tails, posterior = outcomes.degrees_of_freedom[chosen], outcomes.log_density[chosen]
    found = nees(error, covariance)
    probability = ellipsoid_probability(found, tails)
    inside = [int((probability <= level).sum()) for level in LEVELS]
    return Calibration(
        count=len(found),
        coverage=tuple(wilson_interval(count, len(found)) for count in inside),
        nees_mean=float(found.mean()),
        nees_median=float(np.median(found)),
        spread_nll=float(-log_density(error, covariance, tails).mean()),
        posterior_nll=None if np.isnan(posterior).any() else float(-posterior.mean()),
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class Warnings:
    """How well a method tells what it does not know.

    Attributes:
        flagged: share of pairs for which it has no estimate or calls it ambiguous.
        wrong_unflagged: share of the others that exceed WRONG_M or WRONG_RAD.
        wrong_flagged: the same share among those that are flagged.
    """

    flagged: Interval
    wrong_unflagged: Interval
    wrong_flagged: Interval


def warnings(outcomes: Outcomes) -> Warnings:
    """Count what is flagged and what is wrong."""
    flagged, wrong = outcomes.flagged, outcomes.wrong
    return Warnings(
        flagged=wilson_interval(int(flagged.sum()), len(flagged)),
        wrong_unflagged=wilson_interval(int((wrong & ~flagged).sum()), int((~flagged).sum())),
        wrong_flagged=wilson_interval(int((wrong & flagged).sum()), int(flagged.sum())),
    )
