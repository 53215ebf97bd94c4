from __future__ import annotations

import math

import numpy as np
import pytest
from rendezvous.evaluation.relative_pose.errors import PoseOutcome, as_seen
from rendezvous.geometry.camera import se3_from_se2
from rendezvous.geometry.se2 import SE2

from tests.evaluation.toy_poses import T_R0_C, drawn_truths, mode, outcomes, read_as, truth

AHEAD = SE2(2.0, 0.3, 0.4)


def test_the_truth_has_no_error():
    truths = drawn_truths(20)
    found = outcomes(truths, [read_as(mode(t.T_r0_r1)) for t in truths])
    assert found.detected.all()
    assert found.error == pytest.approx(np.zeros((20, 3)), abs=1e-12)
    assert found.theta == pytest.approx(np.zeros((20, 3)), abs=1e-12)
    assert not found.confused.any()


def test_the_error_is_what_the_estimate_lacks_seen_from_it():
    off = SE2(0.1, -0.2, 0.3)
    found = outcomes([truth(0, AHEAD @ off)], [read_as(mode(AHEAD))])
    assert found.error[0] == pytest.approx([0.1, -0.2, 0.3])
    assert found.position_m[0] == pytest.approx(math.hypot(0.1, 0.2))


def test_the_frame_error_turns_about_the_meeting_point_and_not_about_robot_0():
    turned = outcomes([truth(0, AHEAD @ SE2(0.0, 0.0, -0.5))], [read_as(mode(AHEAD))])
    assert turned.theta[0] == pytest.approx([0.0, 0.0, 0.5])
    moved = outcomes([truth(0, SE2(2.0, 0.3, 0.4))], [read_as(mode(SE2(2.5, 0.3, 0.4)))])
    assert moved.theta[0] == pytest.approx([0.5, 0.0, 0.0])


@pytest.mark.parametrize("flip", [math.pi, -math.pi, 0.6 * math.pi])
def test_a_turn_by_more_than_a_right_angle_is_a_confusion(flip):
    wrong = AHEAD @ SE2(0.0, 0.0, flip)
    alone = outcomes([truth(0, AHEAD)], [read_as(mode(wrong))])
    both = outcomes([truth(0, AHEAD)], [read_as(mode(wrong, mass=0.6), mode(AHEAD, mass=0.4))])
    assert alone.confused[0]
    assert both.confused[0]
    assert not alone.told_otherwise[0]
    assert both.told_otherwise[0]


def test_the_window_holds_what_any_reading_puts_there():
    flipped = mode(AHEAD @ SE2(0.0, 0.0, math.pi), mass=0.6)
    found = outcomes([truth(0, AHEAD)], [read_as(flipped, mode(AHEAD, mass=0.4))])
    assert np.abs(found.thetas(0)[:, 2]) == pytest.approx([math.pi, 0.0])


def test_a_turn_by_less_is_none():
    found = outcomes([truth(0, AHEAD)], [read_as(mode(AHEAD @ SE2(0.0, 0.0, 0.4 * math.pi)))])
    assert not found.confused[0]


def test_a_missed_robot_has_no_error_and_a_false_one_is_no_detection():
    truths = [truth(0, AHEAD), truth(1, None), truth(2, AHEAD, visibility=0.0), truth(3, None)]
    found = outcomes(truths, [read_as(), read_as(mode(AHEAD)), read_as(mode(AHEAD)), read_as()])
    assert found.shows_robot.tolist() == [True, False, False, False]
    assert found.found.tolist() == [False, True, True, False]
    assert not found.detected.any()
    assert np.isnan(found.error).all()
    assert np.isnan(found.covariance).all()
    assert not found.confused.any()


@pytest.mark.parametrize(
    ("yaw_rad", "heading_rad"), [(0.0, 0.0), (math.pi / 2, math.pi / 2), (math.pi, math.pi), (-1.0, -1.0)]
)
def test_straight_ahead_a_robot_is_seen_at_the_heading_that_it_has(yaw_rad, heading_rad):
    distance_m, seen_rad = as_seen(np.linalg.inv(T_R0_C) @ se3_from_se2(SE2(1.03, 0.0, yaw_rad)))
    assert distance_m == pytest.approx(math.hypot(1.0, 0.12))
    assert abs(math.remainder(seen_rad - heading_rad, 2 * math.pi)) == pytest.approx(0.0, abs=1e-12)


def test_a_robot_to_the_left_that_faces_ahead_is_seen_from_its_right():
    # Its bearing is 45° to the left, so of the line of sight it faces 45° to the right.
    _, seen_rad = as_seen(np.linalg.inv(T_R0_C) @ se3_from_se2(SE2(1.03, 1.0, 0.0)))
    assert seen_rad == pytest.approx(-math.pi / 4)


@pytest.mark.parametrize(
    "pose",
    [
        read_as(),
        read_as(mode(AHEAD, mass=0.7), mode(SE2(1.0, 0.0, 0.0), mass=0.2)),
        read_as(mode(AHEAD, degrees_of_freedom=4.5)),
    ],
)
def test_outcomes_survive_json(pose):
    row = PoseOutcome.of("image", pose, duration_s=0.25)
    again = PoseOutcome.from_json(row.to_json())
    assert again.to_json() == row.to_json()
    assert again.T_r0_r1 == row.T_r0_r1
    assert again.degrees_of_freedom == row.degrees_of_freedom
    assert again.others == row.others
