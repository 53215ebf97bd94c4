"""Whether a method knows its own error: covariances, densities and flags against the errors."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd

from rendezvous.alignment.frame_error import ellipsoid_probability, log_density, nees
from rendezvous.evaluation.json_record import FiniteOrNot
from rendezvous.evaluation.statistics import Interval, wilson_interval
from rendezvous.geometry.se2 import Array

LEVELS = (0.5, 0.9, 0.95)
"""Probabilities of the ellipsoids whose coverage is reported."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Calibration:
    """How well a method's covariances describe its errors, over the estimates that have one."""

    count: int  # of them
    coverage: tuple[Interval, ...]  # by `LEVELS`, share of errors inside the ellipsoid of that probability
    # nees_mean, nees_median: the mean is 3 if covariances are right; the median is then 2.37 for normal
    # errors, and less for heavy tails.
    nees_mean: FiniteOrNot
    nees_median: float
    # Mean negative log density of the true frame error under the normal or t distribution.
    spread_nll: FiniteOrNot
    posterior_nll: float | None  # the same under the method's own posterior; None if it has none


@dataclass(frozen=True, slots=True, kw_only=True)
class Spreads:
    """The K outcomes with a finite covariance: (K, 3) errors, (K, 3, 3) covariances, (K,) the rest."""

    error: Array
    covariance: Array
    degrees_of_freedom: Array
    log_density: Array

    @staticmethod
    def of(outcomes: pd.DataFrame) -> Spreads:
        """From rows of an `outcome_table`."""
        known = [
            covariance is not None and not failed and bool(np.isfinite(covariance).all())
            for covariance, failed in zip(outcomes["covariance"], outcomes["failed"], strict=True)
        ]
        rows = outcomes[np.array(known, dtype=bool)]
        return Spreads(
            error=rows[["x_m", "y_m", "yaw_rad"]].to_numpy(),
            covariance=np.array(rows["covariance"].tolist()).reshape(-1, 3, 3),
            degrees_of_freedom=rows["degrees_of_freedom"].to_numpy(),
            log_density=rows["log_density"].to_numpy(),
        )

    def __len__(self) -> int:
        return len(self.error)

    @property
    def probability(self) -> Array:
        """(K,) probability of the ellipsoid on which each error lies."""
        return ellipsoid_probability(nees(self.error, self.covariance), self.degrees_of_freedom)


def calibration(outcomes: pd.DataFrame) -> Calibration | None:
    """Calibration over rows of an `outcome_table`; None if none of them has a covariance."""
    spreads = Spreads.of(outcomes)
    if not len(spreads):
        return None
    found = nees(spreads.error, spreads.covariance)
    density = log_density(spreads.error, spreads.covariance, spreads.degrees_of_freedom)
    inside = [int((spreads.probability <= level).sum()) for level in LEVELS]
    has_posterior = not np.isnan(spreads.log_density).any()
    return Calibration(
        count=len(found),
        coverage=tuple(wilson_interval(count, len(found)) for count in inside),
        nees_mean=float(found.mean()),
        nees_median=float(np.median(found)),
        spread_nll=float(-density.mean()),
        posterior_nll=float(-spreads.log_density.mean()) if has_posterior else None,
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class Warnings:
    """How well a method flags what it does not know."""

    flagged: Interval  # share of pairs for which it has no estimate or calls it ambiguous
    wrong_unflagged: Interval  # share of the others that are off by more than WRONG_M or WRONG_RAD
    wrong_flagged: Interval  # the same share among the flagged


def warnings(outcomes: pd.DataFrame) -> Warnings:
    """Count flagged and wrong rows of an `outcome_table`."""
    flagged, wrong = outcomes["flagged"], outcomes["wrong"]
    return Warnings(
        flagged=wilson_interval(flagged.sum(), len(flagged)),
        wrong_unflagged=wilson_interval((wrong & ~flagged).sum(), (~flagged).sum()),
        wrong_flagged=wilson_interval((wrong & flagged).sum(), flagged.sum()),
    )
