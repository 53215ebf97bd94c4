from __future__ import annotations

import math

import numpy as np
import pytest
from pytest import approx
from scipy.stats import norm

from rendezvous.evaluation.statistics import Interval, bootstrap_mean, resample_weights, wilson_interval


def test_a_bootstrapped_mean_has_the_interval_of_the_normal_approximation():
    rng = np.random.default_rng(1)
    values = rng.normal(2.0, 3.0, 400)
    found = bootstrap_mean(values, resample_weights(np.arange(400), rng=rng))
    half = norm.ppf(0.975) * values.std() / math.sqrt(400)
    assert found.value == approx(values.mean())
    assert (found.low, found.high) == (
        approx(found.value - half, abs=0.08 * half),
        approx(found.value + half, abs=0.08 * half),
    )


def test_the_interval_covers_the_true_mean_as_often_as_it_says():
    rng = np.random.default_rng(2)
    weights = resample_weights(np.arange(120), rng=rng, resamples=400)
    found = [bootstrap_mean(values, weights) for values in rng.exponential(1.0, (400, 120))]
    assert 0.91 <= np.mean([interval.low <= 1.0 <= interval.high for interval in found]) <= 0.97


def test_pairing_sees_a_small_difference_between_values_that_vary_widely():
    rng = np.random.default_rng(5)
    hard = rng.normal(0.0, 10.0, 50)
    hard -= hard.mean()
    weights = resample_weights(np.arange(50), rng=rng)
    found = bootstrap_mean((hard + 0.1) - hard, weights)
    assert (found.low, found.high) == (approx(0.1), approx(0.1))
    assert found.excludes_zero
    assert not bootstrap_mean(hard + 0.1, weights).excludes_zero


def test_resamples_without_any_of_a_subset_are_left_out():
    weights = resample_weights(np.arange(20), rng=np.random.default_rng(6))
    one = weights[:, :1]
    assert (one.sum(axis=1) == 0.0).any()
    found = bootstrap_mean(np.array([3.0]), one)
    assert (found.value, found.low, found.high) == (3.0, 3.0, 3.0)
    assert math.isnan(bootstrap_mean(np.array([]), weights[:, :0]).value)


def test_an_interval_of_the_other_sign_still_goes_from_low_to_high():
    found = Interval(value=0.2, low=-0.1, high=0.5).scaled(-100.0)
    assert (found.value, found.low, found.high) == (-20.0, -50.0, 10.0)
    assert not found.excludes_zero


@pytest.mark.parametrize(("successes", "trials"), [(0, 20), (1, 7), (50, 100), (960, 1000), (20, 20), (0, 0)])
def test_wilsons_bounds_are_the_shares_at_which_the_score_test_just_rejects(successes: int, trials: int):
    found = wilson_interval(successes, trials)
    if not trials:
        assert math.isnan(found.value)
        return
    z = norm.ppf(0.975)
    for bound in (found.low, found.high):
        variance = bound * (1.0 - bound) / trials
        assert abs(successes / trials - bound) == approx(z * math.sqrt(variance))
    assert 0.0 <= found.low <= found.value == successes / trials <= found.high <= 1.0
    assert found.high - found.low > 0.01


def test_copies_of_a_floor_plans_pairs_make_nothing_surer():
    values, plans = np.random.default_rng(3).normal(size=30), np.arange(30)
    single, copied, alone = (
        bootstrap_mean(v, resample_weights(groups, rng=np.random.default_rng(4)))
        for v, groups in (
            (values, plans),
            (values.repeat(10), plans.repeat(10)),
            (values.repeat(10), np.arange(300)),
        )
    )
    assert (copied.value, copied.low, copied.high) == approx((single.value, single.low, single.high))
    assert alone.high - alone.low < 0.5 * (copied.high - copied.low)
