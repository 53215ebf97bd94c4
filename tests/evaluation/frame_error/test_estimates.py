from __future__ import annotations

import json
import math

import numpy as np
import pytest
from pytest import approx
from rendezvous.alignment.estimate import Estimate
from rendezvous.alignment.frame_error import corrected, frame_error
from rendezvous.evaluation.frame_error.estimates import (
    SUCCESS_M,
    SUCCESS_RAD,
    Outcome,
    Outcomes,
    Pairs,
    outcome,
)
from rendezvous.geometry.se2 import SE2

from tests.evaluation.toy_pairs import outcomes_of, toy_pair, toy_sample

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
    assert outcomes.position_m == approx([0.1, 0.1])


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
    assert len(Outcomes((after,))) == 1


def test_pairs_of_a_floor_plan_are_numbered_alike():
    pairs = Pairs.of(np.array([0.1, 0.2, 0.3]), ["b", "a", "b"])
    assert pairs.plan[0] == pairs.plan[2] != pairs.plan[1]
