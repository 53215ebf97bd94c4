from __future__ import annotations

import math

import numpy as np
import pytest
from pytest import approx
from rendezvous.alignment.estimate import WRONG_M, WRONG_RAD
from rendezvous.alignment.spread import ellipsoid_probability, log_density, nees
from rendezvous.evaluation.frame_error.calibration import (
    LEVELS,
    calibration,
    warnings,
)
from rendezvous.evaluation.frame_error.estimates import SUCCESS_M
from scipy.stats import kstest, multivariate_normal, multivariate_t

from tests.evaluation.toy_pairs import outcomes_of

COUNT = 6000


def _drawn(rng: np.random.Generator, count: int = COUNT):
    """Errors (N, 3) from normal distributions, small so that no yaw wraps, and their covariances."""
    factor = 0.1 * rng.normal(size=(count, 3, 3)) + 0.1 * np.eye(3)
    covariance = factor @ factor.transpose(0, 2, 1)
    return (factor @ rng.normal(size=(count, 3, 1)))[..., 0], covariance


def test_errors_drawn_from_the_covariances_are_found_calibrated():
    error, covariance = _drawn(np.random.default_rng(1))
    outcomes = outcomes_of(-error, covariance=covariance)
    found = calibration(outcomes)
    for level, share in zip(LEVELS, found.coverage, strict=True):
        assert share.value == approx(level, abs=4.0 * math.sqrt(level * (1.0 - level) / COUNT))
    assert found.nees_mean == approx(3.0, abs=0.15)
    assert found.nees_median == approx(2.366, abs=0.12)
    entropy = 0.5 * np.log(np.linalg.det(2.0 * math.pi * math.e * covariance)).mean()
    assert found.spread_nll == approx(entropy, abs=0.1)
    assert found.posterior_nll is None
    probability = ellipsoid_probability(nees(error, covariance), np.full(COUNT, math.inf))
    assert kstest(probability, "uniform").pvalue > 0.01


@pytest.mark.parametrize(("factor", "covered"), [(0.25, False), (4.0, True)])
def test_covariances_too_small_or_too_large_show(factor: float, covered: bool):
    error, covariance = _drawn(np.random.default_rng(2))
    found = calibration(outcomes_of(-error, covariance=factor * covariance))
    assert found.nees_mean == approx(3.0 / factor, rel=0.05)
    assert (found.coverage[1].value > 0.95) == covered
    right = calibration(outcomes_of(-error, covariance=covariance))
    assert found.spread_nll > right.spread_nll + 0.1


def test_the_log_density_is_that_of_scipy():
    error, covariance = _drawn(np.random.default_rng(3), count=20)
    wanted = [multivariate_normal(np.zeros(3), c).logpdf(e) for e, c in zip(error, covariance, strict=True)]
    assert log_density(error, covariance, np.full(20, math.inf)) == approx(np.array(wanted))
    heavy = [
        multivariate_t(np.zeros(3), (nu - 2.0) / nu * c, nu).logpdf(e)
        for e, c, nu in zip(error, covariance, np.arange(3, 23), strict=True)
    ]
    assert log_density(error, covariance, np.arange(3.0, 23.0)) == approx(np.array(heavy))


def test_errors_with_heavy_tails_are_calibrated_by_their_t_distribution_alone():
    rng = np.random.default_rng(4)
    error, covariance = _drawn(rng)
    nu = 4.0
    error *= np.sqrt((nu - 2.0) / rng.chisquare(nu, COUNT))[:, None]
    heavy, normal = (
        calibration(outcomes_of(-error, covariance=covariance, tails=tails)) for tails in (nu, None)
    )
    for level, share in zip(LEVELS, heavy.coverage, strict=True):
        assert share.value == approx(level, abs=4.0 * math.sqrt(level * (1.0 - level) / COUNT))
    assert normal.coverage[0].value > 0.6
    assert heavy.nees_mean == approx(3.0, rel=0.2)
    assert normal.spread_nll > heavy.spread_nll + 0.1


def test_a_covariance_without_volume_is_infinitely_wrong_and_a_missing_one_is_left_out():
    error = np.full((3, 3), 0.1)
    covariance = np.stack([np.eye(3), np.zeros((3, 3)), np.full((3, 3), np.nan)])
    assert nees(error, covariance)[:2].tolist() == [approx(0.03), math.inf]
    assert log_density(error, covariance, np.full(3, math.inf))[1] == -math.inf
    assert np.isnan(nees(error, covariance)[2])
    assert calibration(outcomes_of(error, covariance=covariance)).count == 2
    assert calibration(outcomes_of(error)) is None


def test_warnings_count_what_is_wrong_among_what_is_flagged_and_what_is_not():
    far, turned, near = (
        [WRONG_M + 0.01, 0.0, 0.0],
        [0.0, 0.0, WRONG_RAD + 0.01],
        [SUCCESS_M, 0.0, 0.0],
    )
    outcomes = outcomes_of(
        np.array([far, turned, near, near, far, near]),
        ambiguous=[True, False, False, True, False, False],
        failed=[False, False, False, False, True, False],
    )
    found = warnings(outcomes)
    assert found.flagged.value == approx(3 / 6)
    assert found.wrong_unflagged.value == approx(1 / 3)
    assert found.wrong_flagged.value == approx(2 / 3)
