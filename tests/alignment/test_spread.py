"""Errors against normal and Student's t distributions, by SciPy's own."""

import math

import numpy as np
import pytest
from rendezvous.alignment.spread import ellipsoid_probability, log_density, nees
from scipy import stats

COVARIANCE = np.array([[0.04, 0.01, 0.002], [0.01, 0.09, -0.003], [0.002, -0.003, 0.01]])
ERRORS = np.random.default_rng(0).normal(0.0, 0.3, (6, 3))


def test_a_normal_density_is_scipys():
    found = log_density(ERRORS, np.tile(COVARIANCE, (6, 1, 1)), np.full(6, math.inf))
    assert found == pytest.approx(stats.multivariate_normal(cov=COVARIANCE).logpdf(ERRORS))


@pytest.mark.parametrize("nu", [2.5, 4.0, 30.0])
def test_a_t_density_is_scipys_with_this_covariance(nu: float):
    found = log_density(ERRORS, np.tile(COVARIANCE, (6, 1, 1)), np.full(6, nu))
    law = stats.multivariate_t(shape=(nu - 2.0) / nu * COVARIANCE, df=nu)
    assert found == pytest.approx(law.logpdf(ERRORS))


@pytest.mark.parametrize("nu", [3.0, 10.0, math.inf])
def test_an_ellipsoid_holds_as_many_draws_as_its_probability(nu: float):
    rng = np.random.default_rng(1)
    drawn = rng.multivariate_normal(np.zeros(3), COVARIANCE, 20000)
    if math.isfinite(nu):
        drawn *= np.sqrt((nu - 2.0) / rng.chisquare(nu, 20000))[:, None]
    inside = ellipsoid_probability(nees(drawn, np.tile(COVARIANCE, (20000, 1, 1))), np.full(20000, nu))
    for level in (0.1, 0.5, 0.95):
        assert (inside <= level).mean() == pytest.approx(level, abs=0.012)


def test_an_unknown_covariance_gives_nan_and_a_singular_one_infinity():
    covariance = np.stack([COVARIANCE, np.full((3, 3), np.nan), np.zeros((3, 3)), np.diag([1.0, 4.0, 9.0])])
    found = nees(np.array([ERRORS[0], [1.0, 2.0, 3.0], [1.0, 2.0, 3.0], [1.0, 2.0, 3.0]]), covariance)
    assert found[0] == pytest.approx(ERRORS[0] @ np.linalg.inv(COVARIANCE) @ ERRORS[0])
    assert np.isnan(found[1])
    assert found[2] == math.inf
    assert found[3] == pytest.approx(3.0)
    assert log_density(ERRORS[:1], covariance[2:3], np.array([math.inf]))[0] == -math.inf
