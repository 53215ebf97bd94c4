"""Whether a method knows how far off it is: covariances, densities and warnings against the errors."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2

from pipeline.evaluation.estimates import Outcomes
from pipeline.evaluation.statistics import Interval, wilson_interval
from pipeline.geometry.occupancy_grid import Mask
from pipeline.geometry.se2 import Array

LEVELS = (0.5, 0.9, 0.95)
"""Probabilities of the ellipsoids whose coverage is told."""
_DEGREES_OF_FREEDOM = 3


def nees(error: Array, covariance: Array) -> Array:
    """(N,) normalised estimation error squared, dᵀ Σ⁻¹ d, of errors (N, 3); 3 on average if Σ is right.

    NaN where the covariance (N, 3, 3) is; infinite where it is singular.
    """
    out = np.full(len(error), np.nan)
    known = np.flatnonzero(np.isfinite(covariance).all(axis=(1, 2)))
    singular = np.linalg.det(covariance[known]) <= 0.0
    out[known[singular]] = np.inf
    good = known[~singular]
    solved = np.linalg.solve(covariance[good], error[good][..., None])[..., 0]
    out[good] = np.einsum("ni,ni->n", error[good], solved)
    return out


def gaussian_log_density(error: Array, covariance: Array) -> Array:
    """(N,) log density of errors (N, 3) under normal distributions [1 / (m² rad)]; -inf for a singular one.

    Args:
        error: x [m], y [m], yaw [rad].
        covariance: (N, 3, 3) of each.
    """
    distance = nees(error, covariance)
    _, log_det = np.linalg.slogdet(np.where(np.isfinite(distance)[:, None, None], covariance, np.eye(3)))
    return -0.5 * (distance + log_det + _DEGREES_OF_FREEDOM * math.log(2.0 * math.pi))


def chi_square_probability(nees_N: Array) -> Array:
    """(N,) probability of the smallest ellipsoid that holds each error; uniform on [0, 1] if Σ is right."""
    return np.asarray(chi2.cdf(nees_N, _DEGREES_OF_FREEDOM))


@dataclass(frozen=True, slots=True, kw_only=True)
class Calibration:
    """How well a method's covariances tell its errors, over the estimates that have one.

    Attributes:
        count: how many.
        coverage: by `LEVELS`, share of errors inside the ellipsoid of that probability.
        nees_mean, nees_median: 3 and 2.37 if covariances are right.
        gaussian_nll: mean negative log density of the true frame error under the normal distribution.
        posterior_nll: the same under the method's own posterior; None if it has none.
    """

    count: int
    coverage: tuple[Interval, ...]
    nees_mean: float
    nees_median: float
    gaussian_nll: float
    posterior_nll: float | None


def calibration(outcomes: Outcomes, chosen: Mask) -> Calibration | None:
    """Of the chosen (N,) outcomes, those with a covariance; None if there are none."""
    chosen = chosen & ~outcomes.failed & np.isfinite(outcomes.covariance).all(axis=(1, 2))
    if not chosen.any():
        return None
    error, covariance = outcomes.error[chosen], outcomes.covariance[chosen]
    found, log_density = nees(error, covariance), outcomes.log_density[chosen]
    inside = [int((found <= chi2.ppf(level, _DEGREES_OF_FREEDOM)).sum()) for level in LEVELS]
    return Calibration(
        count=len(found),
        coverage=tuple(wilson_interval(count, len(found)) for count in inside),
        nees_mean=float(found.mean()),
        nees_median=float(np.median(found)),
        gaussian_nll=float(-gaussian_log_density(error, covariance).mean()),
        posterior_nll=None if np.isnan(log_density).any() else float(-log_density.mean()),
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
