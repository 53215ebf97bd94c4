from __future__ import annotations

import json
import math

import numpy as np
import pytest
from pytest import approx

from rendezvous.alignment.estimate import WRONG_M, WRONG_RAD, Estimate
from rendezvous.alignment.frame_error import corrected, frame_error
from rendezvous.evaluation.frame_error.estimates import (
    OVERLAP_BINS,
    SUCCESS_M,
    SUCCESS_RAD,
    Outcome,
    outcome,
    outcome_table,
)
from rendezvous.geometry.se2 import SE2
from tests.evaluation.toy_pairs import outcomes_of, toy_outcomes, toy_pair, toy_sample

OFF = SE2(0.2, -0.1, 0.05)


@pytest.fixture(scope="module")
def seen():
    pair = toy_pair(3)
    return pair, toy_sample(pair)


@pytest.mark.parametrize("off", [SE2.identity(), OFF])
def test_an_estimates_error_is_the_frame_error_that_the_corrected_transform_still_has(seen, off: SE2):
    pair, sample = seen
    estimate = Estimate(theta=sample.theta_v @ off.inverse())
    found = outcome(estimate, pair, sample, duration_s=0.0)
    left = frame_error(
        corrected(sample.T_estimated, estimate.theta, sample.T_m0_v), pair.T_m0_m1, sample.T_m0_v
    )
    assert found.error.as_array() == approx(off.as_array(), abs=1e-9)
    assert left.as_array() == approx(off.as_array(), abs=1e-9)
    assert (found.meeting_error_m < 1e-9) == (off == SE2.identity())


def test_a_failure_leaves_the_transform_as_it_was_given(seen):
    pair, sample = seen
    found = outcome(Estimate(theta=None, reason="nothing seen"), pair, sample, duration_s=0.0)
    assert found.error == sample.theta_v.wrapped()
    given, true = sample.T_estimated @ pair.T_m1_r1, pair.T_m0_r1
    assert found.meeting_error_m == approx(np.hypot(given.x_m - true.x_m, given.y_m - true.y_m))
    assert found.reason == "nothing seen"


def test_success_has_a_bound_in_position_and_one_in_heading_and_a_failure_is_none():
    inside = [SUCCESS_M * 0.6, SUCCESS_M * 0.79, -0.99 * SUCCESS_RAD]
    far, turned = [SUCCESS_M * 0.8, SUCCESS_M * 0.8, 0.0], [0.0, 0.0, -1.01 * SUCCESS_RAD]
    outcomes = outcomes_of(np.array([inside, far, turned, inside]), failed=[False, False, False, True])
    assert outcomes.success.tolist() == [True, False, False, False]
    assert outcomes.flagged.tolist() == [False, False, False, True]


@pytest.mark.parametrize("theta_hat", [OFF, None])
def test_an_outcome_survives_json(theta_hat: SE2 | None):
    before = Outcome(
        pair_id="a",
        theta=SE2(1.0, 2.0, 3.0),
        theta_hat=theta_hat,
        covariance=None if theta_hat is None else np.diag([1.0, 2.0, 3.0]),
        degrees_of_freedom=math.inf if theta_hat is None else 4.5,
        ambiguous=True,
        reason="" if theta_hat else "why not",
        log_density=None if theta_hat is None else -1.5,
        meeting_error_m=0.25,
        duration_s=0.1,
    )
    after = Outcome.from_json(json.loads(json.dumps(before.to_json())))
    assert after.to_json() == before.to_json()
    assert after.error == before.error


def test_a_table_has_one_row_for_each_pair_under_each_method_by_the_pairs_number():
    table = outcome_table(
        {name: toy_outcomes([toy_pair(3), toy_pair(4)], off=OFF) for name in ("b", "a")}, np.array([0.2, 0.8])
    )
    assert table.reset_index()[["index", "method", "overlap"]].to_numpy().tolist() == [
        *([0, "b", 0.2], [1, "b", 0.8], [0, "a", 0.2], [1, "a", 0.8])
    ]
    assert table.position_m.tolist() == approx([math.hypot(0.2, -0.1)] * 4)
    assert table.heading_rad.tolist() == approx([0.05] * 4)


def test_an_overlap_on_an_edge_is_in_the_bin_above_it():
    table = outcomes_of(np.zeros((5, 3)), overlap=[0.0, 0.1, 0.25, 0.4999, 0.5])
    assert table.overlaps.tolist() == [OVERLAP_BINS[k] for k in (0, 1, 2, 2, 3)]


def test_an_error_is_wrong_only_beyond_a_bound():
    errors = [[WRONG_M, 0.0, 0.0], [WRONG_M + 1e-9, 0.0, 0.0], [0.0, 0.0, -WRONG_RAD], [0.0, 0.0, -0.1]]
    assert outcomes_of(np.array(errors)).wrong.tolist() == [False, True, False, True]
