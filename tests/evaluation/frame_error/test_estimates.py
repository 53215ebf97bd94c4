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


def test_a_perfect_estimate_puts_robot_1_where_it_stands(seen):
    pair, sample = seen
    found = outcome(Estimate(theta=sample.theta_v), pair, sample, duration_s=0.0)
    assert found.error.as_array() == approx(np.zeros(3), abs=1e-9)
    assert found.meeting_error_m == approx(0.0, abs=1e-9)


def test_an_estimates_error_is_the_frame_error_that_the_corrected_transform_still_has(seen):
    pair, sample = seen
    estimate = Estimate(theta=sample.theta_v @ OFF.inverse())
    found = outcome(estimate, pair, sample, duration_s=0.0)
    T_hat = corrected(sample.T_estimated, estimate.theta, sample.T_m0_v)
    left = frame_error(T_hat, pair.T_m0_m1, sample.T_m0_v)
    assert found.error.as_array() == approx(OFF.as_array(), abs=1e-9)
    assert left.as_array() == approx(OFF.as_array(), abs=1e-9)


def test_a_failure_leaves_the_transform_as_it_was_given(seen):
    pair, sample = seen
    found = outcome(Estimate(theta=None, reason="nothing seen"), pair, sample, duration_s=0.0)
    assert found.error == sample.theta_v.wrapped()
    given, true = sample.T_estimated @ pair.T_m1_r1, pair.T_m0_r1
    assert found.meeting_error_m == approx(np.hypot(given.x_m - true.x_m, given.y_m - true.y_m))
    assert found.reason == "nothing seen"


def test_a_failure_is_no_success_however_little_was_wrong():
    small = np.array([[0.1, 0.0, 0.0], [0.1, 0.0, 0.0]])
    outcomes = outcomes_of(small, failed=[False, True])
    assert outcomes.success.tolist() == [True, False]
    assert outcomes.flagged.tolist() == [False, True]
    assert outcomes.position_m.tolist() == approx([0.1, 0.1])


def test_success_has_a_bound_in_position_and_one_in_heading():
    inside, far, turned = (
        [SUCCESS_M * 0.6, SUCCESS_M * 0.79, -0.99 * SUCCESS_RAD],
        [SUCCESS_M * 0.8, SUCCESS_M * 0.8, 0.0],
        [0.0, 0.0, -1.01 * SUCCESS_RAD],
    )
    assert outcomes_of(np.array([inside, far, turned])).success.tolist() == [True, False, False]


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
    assert list(zip(table.index, table.method, table.overlap, strict=True)) == [
        (0, "b", 0.2),
        (1, "b", 0.8),
        (0, "a", 0.2),
        (1, "a", 0.8),
    ]
    assert table.position_m.tolist() == approx([math.hypot(0.2, -0.1)] * 4)
    assert table.heading_rad.tolist() == approx([0.05] * 4)


def test_an_overlap_on_an_edge_is_in_the_bin_above_it():
    table = outcomes_of(np.zeros((5, 3)), overlap=[0.0, 0.1, 0.25, 0.4999, 0.5])
    assert table.overlaps.tolist() == [OVERLAP_BINS[k] for k in (0, 1, 2, 2, 3)]


def test_an_error_is_wrong_only_beyond_a_bound():
    errors = [[WRONG_M, 0.0, 0.0], [WRONG_M + 1e-9, 0.0, 0.0], [0.0, 0.0, -WRONG_RAD], [0.0, 0.0, -0.1]]
    assert outcomes_of(np.array(errors)).wrong.tolist() == [False, True, False, True]
