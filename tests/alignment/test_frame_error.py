import math

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from pytest import approx
from rendezvous.alignment.frame_error import (
    corrected,
    frame_error,
    initial_alignment,
    meeting_point,
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
