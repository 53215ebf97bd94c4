from __future__ import annotations

import math
from dataclasses import asdict

import numpy as np
import pytest
from pydantic import TypeAdapter
from rendezvous.evaluation.relative_pose.summary import (
    HEADINGS,
    PoseSummary,
    groupings,
    pose_summary,
    target_images,
)
from rendezvous.geometry.se2 import SE2

from tests.evaluation.toy_poses import drawn_truths, mode, outcomes, read_as, truth


def _flat(summary: PoseSummary) -> dict:
    return asdict(summary)


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


def test_groups_part_the_images_that_show_the_robot():
    truths = [*drawn_truths(60), truth(60, None), truth(61, SE2(1.0, 0.0, 0.0), kind="sighting")]
    found = outcomes(truths, [read_as(mode(SE2(1.0, 0.0, 0.0))) for _ in truths])
    for groups in groupings(found).values():
        assert np.stack(list(groups.values())).sum(axis=0).tolist() == found.shows_robot.tolist()


@pytest.mark.parametrize("step", range(8))
def test_sectors_are_centred_on_multiples_of_45_degrees(step):
    for off_deg in (-22.0, 0.0, 22.0):
        pose = SE2(1.03, 0.0, math.radians(45.0 * step + off_deg))
        found = outcomes([truth(0, pose)], [read_as()])
        named = [label for label, mask in groupings(found)["heading"].items() if mask[0]]
        assert named == [HEADINGS[step]]


def test_the_goal_is_for_plausible_images_of_near_and_visible_robots():
    near, far = SE2(2.0, 0.0, 0.0), SE2(3.0, 0.0, 0.0)
    truths = [
        truth(0, near, visibility=0.6),
        truth(1, near, visibility=0.4),
        truth(2, far, visibility=0.6),
        truth(3, near, visibility=0.6, kind="sighting"),
        truth(4, None),
    ]
    assert target_images(outcomes(truths, [read_as()] * 5)).tolist() == [True, False, False, False, False]


def test_a_summary_survives_json():
    truths = [*drawn_truths(7), truth(7, None)]
    for poses in ([read_as(mode(SE2(1.0, 0.0, 0.0)))] * 8, [read_as()] * 8):
        found = pose_summary(outcomes(truths, poses))
        assert TypeAdapter(PoseSummary).validate_python(_flat(found)) == found
