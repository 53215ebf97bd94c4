import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pytest import approx
from scipy import stats

from rendezvous.alignment.frame_error import (
    corrected,
    ellipsoid_probability,
    frame_error,
    initial_alignment,
    log_density,
    meeting_point,
    nees,
    perturbed,
    pose_difference,
)
from rendezvous.geometry.se2 import SE2

metres = st.floats(-12.0, 12.0)
headings = st.floats(-3.1, 3.1)
poses = st.builds(SE2, metres, metres, headings)
errors = st.builds(SE2, st.floats(-2.0, 2.0), st.floats(-2.0, 2.0), st.floats(-math.pi / 4, math.pi / 4))


def assert_same(pose: SE2, other: SE2) -> None:
    np.testing.assert_allclose(pose.matrix(), other.matrix(), atol=1e-9)


@given(poses, poses, poses)
def test_true_poses_chain_to_the_true_alignment(T_m0_m1: SE2, T_m0_r0: SE2, T_m1_r1: SE2):
    T_r0_r1 = T_m0_r0.inverse() @ T_m0_m1 @ T_m1_r1
    assert_same(initial_alignment(T_m0_r0, T_r0_r1, T_m1_r1), T_m0_m1)


@given(poses, poses, poses)
def test_correcting_by_the_frame_error_restores_the_truth(T_estimated: SE2, T_true: SE2, T_m0_v: SE2):
    theta_v = frame_error(T_estimated, T_true, T_m0_v)
    assert_same(corrected(T_estimated, theta_v, T_m0_v), T_true)


def test_perfect_theta_restores_the_truth_ten_metres_from_the_origin():
    T_true, T_m0_r1, theta = SE2(3.0, -2.0, 2.5), SE2(8.0, -6.0, 0.3), SE2(1.9, -1.7, 0.78)
    T_estimated, T_m0_c = perturbed(T_true, T_m0_r1, theta)
    assert math.hypot(T_m0_c.x_m, T_m0_c.y_m) > 8.0
    assert corrected(T_estimated, theta, T_m0_c).as_array() == approx(T_true.as_array(), abs=1e-9)


@given(poses, poses, errors)
def test_perturbation_is_centred_where_its_estimate_puts_robot_1(T_true: SE2, T_m1_r1: SE2, theta: SE2):
    T_estimated, T_m0_c = perturbed(T_true, T_true @ T_m1_r1, theta)
    assert_same(T_m0_c, meeting_point(T_estimated, T_m1_r1))
    assert_same(frame_error(T_estimated, T_true, T_m0_c), theta)


@given(poses, poses, errors, headings)
def test_turning_the_window_conjugates_the_frame_error(T_true: SE2, T_m0_r1: SE2, theta: SE2, turn: float):
    T_estimated, T_m0_c = perturbed(T_true, T_m0_r1, theta)
    T_c_v = SE2(0.0, 0.0, turn)
    theta_v = frame_error(T_estimated, T_true, T_m0_c @ T_c_v)
    assert_same(theta_v, T_c_v.inverse() @ theta @ T_c_v)


@given(poses, errors)
def test_the_difference_of_poses_undoes_itself(theta: SE2, step: SE2):
    assert_same(pose_difference(theta, theta @ step), step)
    assert_same(pose_difference(theta @ step, theta), step.inverse())


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
