from __future__ import annotations

import math
from dataclasses import asdict, astuple

import numpy as np
import pytest
from pydantic import TypeAdapter
from rendezvous.evaluation.relative_pose.errors import PoseOutcome, pose_table
from rendezvous.evaluation.relative_pose.summary import (
    GROUPS,
    HEADINGS,
    PoseSummary,
    grouped,
    has_goal,
    pose_summary,
)
from rendezvous.geometry.se2 import SE2

from tests.evaluation.toy_poses import drawn_truths, mode, outcomes, read_as, truth


def test_the_truth_reaches_the_goal_and_lies_inside_every_ellipsoid():
    truths = [*drawn_truths(40), truth(40, None)]
    found = pose_summary(
        outcomes(truths, [read_as(mode(t.T_r0_r1)) if t.T_r0_r1 else read_as() for t in truths])
    )
    assert found.reached
    assert found.overall.position_m.largest == pytest.approx(0.0, abs=1e-9)
    assert [share.count for share in found.coverage.inside] == [40, 40, 40]
    assert found.window.inside.interval.value == 1.0
    assert (found.false_detections.count, found.false_detections.of) == (0, 1)


@pytest.mark.parametrize("tails", [math.inf, 6.0])
def test_errors_drawn_from_the_covariance_are_covered_as_often_as_it_says(tails):
    rng, truths = np.random.default_rng(0), drawn_truths(4000)
    # Of the standard deviation that the estimates tell.
    errors = rng.normal(0.0, 0.01, (len(truths), 3))
    if math.isfinite(tails):
        errors *= np.sqrt((tails - 2.0) / rng.chisquare(tails, (len(truths), 1)))
    poses = [
        read_as(mode(t.T_r0_r1 @ SE2.from_array(e).inverse(), sigma=0.01, degrees_of_freedom=tails))
        for t, e in zip(truths, errors, strict=True)
    ]
    found = pose_summary(outcomes(truths, poses))
    shares = [share.interval.value for share in found.coverage.inside]
    assert shares == pytest.approx([0.5, 0.9, 0.95], abs=0.025)
    assert found.coverage.nees_mean == pytest.approx(3.0, abs=0.2)


def test_an_estimator_that_turns_all_robots_around_is_confused_every_time():
    truths = drawn_truths(12)
    poses = [read_as(mode(t.T_r0_r1 @ SE2(0.0, 0.0, math.pi))) for t in truths]
    found = pose_summary(outcomes(truths, poses))
    assert (found.overall.confused.count, found.overall.confused.of) == (12, 12)
    assert found.window.inside.count == 0
    assert not found.reached


def test_what_is_never_found_has_no_errors_but_is_counted():
    truths = drawn_truths(9)
    found = pose_summary(outcomes(truths, [read_as() for _ in truths]))
    assert (found.overall.detected.count, found.overall.detected.of) == (0, 9)
    assert found.overall.position_m is None
    assert found.coverage is None
    assert found.window is None
    assert not found.reached


def test_false_detections_are_of_images_without_the_robot_and_of_covered_copies():
    pose = SE2(1.0, 0.0, 0.0)
    truths = [truth(0, pose), truth(1, None), truth(2, None), truth(3, pose), truth(4, pose)]
    rows = [
        PoseOutcome.of(t.image_id, read, duration_s=duration_s, found_covered=covered)
        for t, read, duration_s, covered in zip(
            truths,
            [read_as(mode(pose)), read_as(mode(pose)), read_as(), read_as(), read_as(mode(pose))],
            (1.0, 2.0, 3.0, 4.0, 6.0),
            (True, None, None, False, False),
            strict=True,
        )
    ]
    found = pose_summary(pose_table(truths, rows))
    assert (found.false_detections.count, found.false_detections.of) == (1, 2)
    assert (found.false_covered.count, found.false_covered.of) == (1, 3)
    assert (found.duration_median_s, found.duration_p95_s) == pytest.approx((3.0, 5.6))


def test_every_image_that_shows_the_robot_is_in_one_group_of_each_kind():
    truths = [*drawn_truths(60), truth(60, None), truth(61, SE2(1.0, 0.0, 0.0), kind="sighting")]
    found = pose_summary(outcomes(truths, [read_as(mode(SE2(1.0, 0.0, 0.0))) for _ in truths]))
    assert found.by.keys() == GROUPS.keys()
    assert {name: sum(g.detected.of for g in groups.values()) for name, groups in found.by.items()} == (
        dict.fromkeys(GROUPS, 61)
    )


@pytest.mark.parametrize(
    ("x_m", "visibility", "distances", "visibilities"),
    [
        *((0.9, 0.1, "< 1 m", "< 0.25"), (1.5, 0.25, "1–1.75 m", "0.25–0.5")),
        *((2.0, 0.6, "1.75–2.5 m", "0.5–0.75"), (3.0, 0.75, "2.5–3.5 m", "> 0.75")),
        (4.0, 1.0, "> 3.5 m", "> 0.75"),
    ],
)
def test_images_are_binned_by_distance_and_visibility(x_m, visibility, distances, visibilities):
    found = outcomes([truth(0, SE2(x_m, 0.0, 0.0), visibility=visibility)], [read_as()])
    row = grouped(found).loc[0]
    assert (row.distances, row.visibilities) == (distances, visibilities)


@pytest.mark.parametrize("step", range(8))
def test_sectors_are_centred_on_multiples_of_45_degrees(step):
    poses = [SE2(1.03, 0.0, math.radians(45.0 * step + off_deg)) for off_deg in (-22.0, 0.0, 22.0)]
    found = outcomes([truth(i, pose) for i, pose in enumerate(poses)], [read_as()] * 3)
    assert grouped(found).headings.tolist() == [HEADINGS[step]] * 3


def test_the_goal_is_for_plausible_images_of_near_and_visible_robots():
    near, far = SE2(2.0, 0.0, 0.0), SE2(3.0, 0.0, 0.0)
    truths = [
        truth(0, near, visibility=0.6),
        truth(1, near, visibility=0.4),
        truth(2, far, visibility=0.6),
        truth(3, near, visibility=0.6, kind="sighting"),
        truth(4, None),
    ]
    assert has_goal(outcomes(truths, [read_as()] * 5)).tolist() == [True, False, False, False, False]


def test_medians_tails_and_shares_are_those_of_the_errors():
    off_m = np.linspace(0.0, 1.0, 101)
    truths = [truth(i, SE2(2.0, 0.0, 0.0)) for i in range(102)]
    poses = [read_as(mode(SE2(2.0, 0.0, 0.0) @ SE2(x_m, 0.0, 0.1 * x_m).inverse())) for x_m in off_m]
    found = pose_summary(outcomes(truths, [*poses, read_as()])).overall
    assert (found.detected.count, found.detected.of) == (101, 102)
    assert found.median == pytest.approx((0.5, 0.0, 0.05))
    assert astuple(found.position_m) == pytest.approx((0.5, 0.95, 0.99, 1.0))
    assert astuple(found.heading_rad) == pytest.approx((0.05, 0.095, 0.099, 0.1))


@pytest.mark.parametrize(
    ("off", "missed", "reached"),
    [((0.04, 0.05), 0, True), ((0.06, 0.0), 0, False), ((0.0, 0.06), 0, False), ((0.0, 0.0), 2, False)],
)
def test_the_goal_asks_for_position_heading_and_detections(off, missed, reached):
    truths = [truth(i, SE2(2.0, 0.0, 0.0)) for i in range(20)]
    read = read_as(mode(SE2(2.0, 0.0, 0.0) @ SE2(off[0], 0.0, off[1]).inverse()))
    poses = [read_as()] * missed + [read] * (20 - missed)
    assert pose_summary(outcomes(truths, poses)).reached == reached


def test_a_summary_survives_json():
    truths = [*drawn_truths(7), truth(7, None)]
    for poses in ([read_as(mode(SE2(1.0, 0.0, 0.0)))] * 8, [read_as()] * 8):
        found = pose_summary(outcomes(truths, poses))
        assert TypeAdapter(PoseSummary).validate_python(asdict(found)) == found
