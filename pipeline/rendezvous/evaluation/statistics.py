"""Confidence intervals of measured means and shares.

Pairs from one floor plan share its walls, and two pairs from one rendezvous even their maps, so resamples
draw whole floor plans. Resampling single pairs would make intervals too narrow.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rendezvous.evaluation.json_record import NanOrNumber
from rendezvous.geometry.se2 import Array

LEVEL = 0.95
RESAMPLES = 2000


@dataclass(frozen=True, slots=True, kw_only=True)
class Interval:
    """A measured value and its confidence interval; NaN where there is nothing to measure."""

    value: NanOrNumber
    low: NanOrNumber
    high: NanOrNumber

    def scaled(self, factor: float) -> Interval:
        """The interval times a factor: in another unit, or with the other sign."""
        low, high = sorted((factor * self.low, factor * self.high))
        return Interval(value=factor * self.value, low=low, high=high)

    @property
    def excludes_zero(self) -> bool:
        """Whether the sign is beyond doubt."""
        return self.low > 0.0 or self.high < 0.0


NOTHING = Interval(value=math.nan, low=math.nan, high=math.nan)


def wilson_interval(successes: int, trials: int, *, level: float = LEVEL) -> Interval:
    """A share with Wilson's score interval (1927), which takes trials to be independent."""
    if not trials:
        return NOTHING
    from scipy.stats import binomtest  # takes half a second to import, which `fuse` would pay for nothing

    found = binomtest(int(successes), int(trials)).proportion_ci(level, method="wilson")
    return Interval(value=successes / trials, low=float(found.low), high=float(found.high))


def resample_weights(
    groups: NDArray[np.int64], *, rng: np.random.Generator, resamples: int = RESAMPLES
) -> Array:
    """(R, N) count of each value in each resample.

    Args:
        groups: (N,) numbers; values with the same number are drawn together.
        rng: draws as many groups as there are, uniformly with replacement.
        resamples: R.
    """
    names, group = np.unique(groups, return_inverse=True)
    drawn = rng.multinomial(len(names), np.full(len(names), 1.0 / len(names)), size=resamples)
    return drawn[:, group].astype(np.float64)


def bootstrap_mean(values: Array, weights: Array, *, level: float = LEVEL) -> Interval:
    """The mean of values (N,) with the percentile interval of its resamples (R, N).

    The mean of a difference of two methods on the same pairs gives the paired bootstrap.
    """
    if not len(values):
        return NOTHING
    total = weights.sum(axis=1)
    # A resample may contain none of a subset's plans.
    means = (weights @ values)[total > 0.0] / total[total > 0.0]
    tail = (1.0 - level) / 2.0
    low, high = np.quantile(means, [tail, 1.0 - tail])
    return Interval(value=float(values.mean()), low=float(low), high=float(high))
