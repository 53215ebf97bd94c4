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
    Share,
    grouped,
    has_goal,
    pose_summary,
)
from rendezvous.geometry.se2 import SE2
from tests.evaluation.toy_poses import drawn_truths, mode, outcomes, read_as, truth

KINDS = ("plausible", "sighting")


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


def test_robots_turned_around_are_confused_every_time_and_what_is_never_found_has_no_errors():
    truths = drawn_truths(12)
    turned, missed = (
        pose_summary(outcomes(truths, poses))
        for poses in ([read_as(mode(t.T_r0_r1 @ SE2(0.0, 0.0, math.pi))) for t in truths], [read_as()] * 12)
    )
    assert (turned.overall.confused, turned.window.inside) == (Share(count=12, of=12), Share(count=0, of=12))
    assert missed.overall.detected == Share(count=0, of=12)
    assert {missed.overall.position_m, missed.coverage, missed.window} == {None}
    assert (turned.reached, missed.reached) == (False, False)


def test_false_detections_are_of_images_without_the_robot_and_of_covered_copies():
    pose = SE2(1.0, 0.0, 0.0)
    images = [
        (pose, True, 1.0, True),
        (None, True, 2.0, None),
        (None, False, 3.0, None),
        (pose, False, 4.0, False),
        (pose, True, 6.0, False),
    ]
    truths = [truth(i, T_r0_r1) for i, (T_r0_r1, *_) in enumerate(images)]
    rows = [
        PoseOutcome.of(
            t.image_id, read_as(*[mode(pose)] * read), duration_s=duration_s, found_covered=covered
        )
        for t, (_, read, duration_s, covered) in zip(truths, images, strict=True)
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


def test_path_traced_images_are_a_group_beside_rasterised_ones():
    truths = [
        truth(i, SE2(1.0, 0.0, 0.0), renderer="path-traced" if i < 2 else "rasterised") for i in range(5)
    ]
    found = pose_summary(outcomes(truths, [read_as()] * 5)).by["renderer"]
    assert {name: group.detected.of for name, group in found.items()} == {"path-traced": 2, "rasterised": 3}


@pytest.mark.parametrize(
    ("x_m", "visibility", "distances", "visibilities", "goal"),
    [
        (0.9, 0.1, "< 1 m", "< 0.25", False),
        (1.5, 0.25, "1–1.75 m", "0.25–0.5", False),
        (2.0, 0.4, "1.75–2.5 m", "0.25–0.5", False),
        (2.0, 0.6, "1.75–2.5 m", "0.5–0.75", True),
        (3.0, 0.75, "2.5–3.5 m", "> 0.75", False),
        (4.0, 1.0, "> 3.5 m", "> 0.75", False),
    ],
)
def test_images_are_binned_and_the_goal_is_for_plausible_ones_of_a_near_and_visible_robot(
    x_m, visibility, distances, visibilities, goal
):
    images = [truth(i, SE2(x_m, 0.0, 0.0), visibility=visibility, kind=k) for i, k in enumerate(KINDS)]
    found = outcomes([*images, truth(2, None)], [read_as()] * 3)
    row = grouped(found[found.shows_robot]).loc[0]
    assert (row.distances, row.visibilities) == (distances, visibilities)
    assert has_goal(found).tolist() == [goal, False, False]


def test_sectors_are_centred_on_multiples_of_45_degrees():
    heading_deg = np.add.outer(45.0 * np.arange(8), (-22.0, 0.0, 22.0)).ravel()
    truths = [truth(i, SE2(1.03, 0.0, yaw_rad)) for i, yaw_rad in enumerate(np.radians(heading_deg))]
    assert grouped(outcomes(truths, [read_as()] * 24)).headings.tolist() == np.repeat(HEADINGS, 3).tolist()


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
