from __future__ import annotations

import math

import numpy as np
import pytest
from pytest import approx

from rendezvous.alignment.estimate import WRONG_M, WRONG_RAD
from rendezvous.evaluation.frame_error.calibration import (
    LEVELS,
    calibration,
    warnings,
)
from rendezvous.evaluation.frame_error.estimates import SUCCESS_M
from tests.evaluation.toy_pairs import outcomes_of

COUNT = 6000


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


@pytest.fixture(scope="module", params=[math.inf, 4.0])
def drawn(request):
    """Small errors (N, 3) from normal or from t-distributions, with covariances and degrees of freedom."""
    rng = np.random.default_rng(1)
    factor = 0.1 * rng.normal(size=(COUNT, 3, 3)) + 0.1 * np.eye(3)
    error = (factor @ rng.normal(size=(COUNT, 3, 1)))[..., 0]
    if math.isfinite(nu := request.param):
        error *= np.sqrt((nu - 2.0) / rng.chisquare(nu, COUNT))[:, None]
    return error, factor @ factor.transpose(0, 2, 1), nu


def test_errors_drawn_from_their_distributions_are_found_calibrated(drawn):
    error, covariance, nu = drawn
    found = calibration(outcomes_of(-error, covariance=covariance, tails=nu))
    for level, share in zip(LEVELS, found.coverage, strict=True):
        assert share.value == approx(level, abs=4.0 * math.sqrt(level * (1.0 - level) / COUNT))
    assert found.nees_mean == approx(3.0, rel=0.05 if math.isinf(nu) else 0.2)
    assert found.posterior_nll is None
    if math.isinf(nu):
        entropy = 0.5 * np.log(np.linalg.det(2.0 * math.pi * math.e * covariance)).mean()
        assert found.nees_median == approx(2.366, abs=0.12)
        assert found.spread_nll == approx(entropy, abs=0.1)
    else:
        normal = calibration(outcomes_of(-error, covariance=covariance))
        assert normal.coverage[0].value > 0.6
        assert normal.spread_nll > found.spread_nll + 0.1


@pytest.mark.parametrize(("factor", "covered"), [(0.25, False), (4.0, True)])
def test_covariances_too_small_or_too_large_show(drawn, factor: float, covered: bool):
    error, covariance, nu = drawn
    found, right = (
        calibration(outcomes_of(-error, covariance=scale * covariance, tails=nu)) for scale in (factor, 1.0)
    )
    assert found.nees_mean == approx(right.nees_mean / factor)
    assert (found.coverage[1].value > 0.95) == covered
    assert found.spread_nll > right.spread_nll + 0.1


def test_a_covariance_without_volume_is_infinitely_wrong_and_a_missing_one_is_left_out():
    error = np.full((3, 3), 0.1)
    covariance = np.stack([np.eye(3), np.zeros((3, 3)), np.full((3, 3), np.nan)])
    found = calibration(outcomes_of(error, covariance=covariance))
    assert (found.count, found.nees_mean, found.spread_nll) == (2, math.inf, math.inf)
    assert calibration(outcomes_of(error)) is None
