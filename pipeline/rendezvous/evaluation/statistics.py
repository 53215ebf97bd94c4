"""How far measured means and shares can be trusted.

Pairs of one floor plan share its walls, and two pairs of one meeting even their maps; so resamples draw whole
floor plans. Resampling single pairs would make intervals too narrow.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

from rendezvous.geometry.se2 import Array

LEVEL = 0.95
RESAMPLES = 2000


@dataclass(frozen=True, slots=True, kw_only=True)
class Interval:
    """A measured value and its confidence interval; NaN where there is nothing to measure or to resample."""

    value: float
    low: float
    high: float

    def scaled(self, factor: float) -> Interval:
        """In another unit, or with the other sign."""
        low, high = sorted((factor * self.low, factor * self.high))
        return Interval(value=factor * self.value, low=low, high=high)

    @property
    def excludes_zero(self) -> bool:
        """Whether the sign is beyond doubt."""
        return self.low > 0.0 or self.high < 0.0


NOTHING = Interval(value=math.nan, low=math.nan, high=math.nan)


def wilson_interval(successes: int, trials: int, *, level: float = LEVEL) -> Interval:
    """A share with Wilson's score interval (1927), which takes trials as independent."""
    if not trials:
        return NOTHING
    z, share = float(ndtri(0.5 + level / 2.0)), successes / trials
    middle = (share + z * z / (2.0 * trials)) / (1.0 + z * z / trials)
    half = z / (1.0 + z * z / trials) * math.sqrt(share * (1.0 - share) / trials + (z / (2.0 * trials)) ** 2)
    return Interval(value=share, low=max(0.0, middle - half), high=min(1.0, middle + half))


def resample_weights(
    groups: NDArray[np.int64], *, rng: np.random.Generator, resamples: int = RESAMPLES
) -> Array:
    """(R, N) how often each value occurs in each resample.

    Args:
        groups: (N,) values with the same number are drawn together.
        rng: groups are drawn with replacement, uniformly, as many as there are.
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
    # A resample may hold none of a subset's plans.
    means = (weights @ values)[total > 0.0] / total[total > 0.0]
    tail = (1.0 - level) / 2.0
    low, high = np.quantile(means, [tail, 1.0 - tail])
    return Interval(value=float(values.mean()), low=float(low), high=float(high))
