from __future__ import annotations

import math

import numpy as np
import pytest

from rendezvous.evaluation.relative_pose.errors import PoseOutcome, as_seen, pose_table
from rendezvous.geometry.camera import se3_from_se2
from rendezvous.geometry.se2 import SE2
from tests.evaluation.toy_poses import T_R0_C, drawn_truths, mode, outcomes, read_as, truth

AHEAD = SE2(2.0, 0.3, 0.4)
ERROR = ["dx_m", "dy_m", "dyaw_rad"]


def _outcome(read: SE2, *others: SE2, true: SE2 = AHEAD):
    """The row of the table for one image, read so."""
    modes = [mode(T, mass=0.6 / 2**i) for i, T in enumerate((read, *others))]
    return outcomes([truth(0, true)], [read_as(*modes)]).loc[0]


def test_the_truth_has_no_error():
    truths = drawn_truths(20)
    found = outcomes(truths, [read_as(mode(t.T_r0_r1)) for t in truths])
    assert found[[*ERROR, "offset_m", "yaw_off_rad"]].to_numpy() == pytest.approx(np.zeros((20, 5)), abs=1e-9)
    assert (found.detected & found.inside & ~found.confused).all()


def test_the_error_is_what_the_estimate_lacks_seen_from_it():
    row = _outcome(AHEAD, true=AHEAD @ SE2(0.1, -0.2, 0.3))
    assert row[ERROR].tolist() == pytest.approx([0.1, -0.2, 0.3])
    assert (row.position_m, row.turn_rad) == pytest.approx((math.hypot(0.1, 0.2), 0.3))
    assert row.nees == pytest.approx((0.1**2 + 0.2**2 + 0.3**2) / 0.1**2)


@pytest.mark.parametrize(
    ("read", "off"), [(AHEAD @ SE2(0.0, 0.0, -0.5), (0.0, 0.5)), (SE2(2.3, 0.7, 0.4), (0.5, 0.0))]
)
def test_the_frame_error_turns_about_the_meeting_point_and_not_about_robot_0(read, off):
    row = _outcome(read)
    assert (row.offset_m, row.yaw_off_rad) == pytest.approx(off)


@pytest.mark.parametrize("flip", [math.pi, -math.pi, 0.6 * math.pi])
def test_a_turn_by_more_than_a_right_angle_is_a_confusion(flip):
    wrong = AHEAD @ SE2(0.0, 0.0, flip)
    alone, both = _outcome(wrong), _outcome(wrong, AHEAD)
    assert (alone.confused, alone.told_otherwise, alone.inside_by_any) == (True, False, False)
    assert (both.confused, both.told_otherwise) == (True, True)
    assert (both.inside, both.inside_by_any) == (False, True)
    less = _outcome(AHEAD @ SE2(0.0, 0.0, 0.4 * math.pi), AHEAD)
    assert (less.confused, less.told_otherwise) == (False, False)


@pytest.mark.parametrize(
    ("x_m", "y_m", "yaw_deg", "inside"),
    [
        *((1.9, 0.0, 0.0, True), (2.1, 0.0, 0.0, False), (1.5, 1.5, 0.0, False)),
        *((0.0, 0.0, 44.0, True), (0.0, 0.0, -44.0, True), (0.0, 0.0, -46.0, False)),
    ],
)
def test_the_window_is_2_m_in_any_direction_and_45_degrees(x_m, y_m, yaw_deg, inside):
    read = SE2(2.0 + x_m, 0.3 + y_m, math.radians(yaw_deg))
    assert _outcome(read, true=SE2(2.0, 0.3, 0.0)).inside == inside


def test_a_missed_robot_has_no_error_and_a_false_one_is_no_detection():
    truths = [truth(0, AHEAD), truth(1, None), truth(2, AHEAD, visibility=0.0), truth(3, None)]
    found = outcomes(truths, [read_as(), read_as(mode(AHEAD)), read_as(mode(AHEAD)), read_as()])
    assert found.shows_robot.tolist() == [True, False, False, False]
    assert found.found.tolist() == [False, True, True, False]
    assert not found.detected.any()
    assert found[[*ERROR, "nees", "ellipsoid", "offset_m"]].isna().all(axis=None)
    assert not found[["confused", "inside", "inside_by_any"]].any(axis=None)


def test_copies_that_were_not_covered_are_null():
    covered = [
        PoseOutcome.of(f"image-{i}", read_as(), duration_s=0.1, found_covered=found)
        for i, found in enumerate((True, None, False))
    ]
    found = pose_table([truth(i, AHEAD) for i in range(3)], covered).found_covered
    assert found.isna().tolist() == [False, True, False]
    assert (found.sum(), found.count()) == (1, 2)


def test_outcomes_of_other_images_are_refused():
    with pytest.raises(AssertionError, match="outcomes of other images"):
        pose_table([truth(0, AHEAD)], [PoseOutcome.of("another", read_as(), duration_s=0.1)])


@pytest.mark.parametrize(
    ("pose", "heading_rad"),
    [
        *((SE2(1.03, 0.0, yaw_rad), yaw_rad) for yaw_rad in (0.0, math.pi / 2, math.pi, -1.0)),
        # To the left by 45°: robot 1 faces ahead, and so to the right of the line of sight.
        (SE2(1.03, 1.0, 0.0), -math.pi / 4),
    ],
)
def test_a_robot_is_seen_at_its_heading_relative_to_the_line_of_sight(pose, heading_rad):
    distance_m, seen_rad = as_seen(np.linalg.inv(T_R0_C) @ se3_from_se2(pose))
    assert distance_m == pytest.approx(math.hypot(1.0, pose.y_m, 0.12))
    assert abs(math.remainder(seen_rad - heading_rad, 2 * math.pi)) == pytest.approx(0.0, abs=1e-12)


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
    assert again.T_r0_r1 == (pose.modes[0].T_r0_r1 if pose.modes else None)
    assert again.degrees_of_freedom == row.degrees_of_freedom
    assert again.others == tuple(mode.T_r0_r1 for mode in pose.modes[1:])
