from __future__ import annotations

import math

import numpy as np
import pytest

from rendezvous.evaluation.fusion.runs import (
    ESTIMATED,
    TRUE,
    RendezvousOutcome,
    run_rendezvous,
    runs_of,
)
from rendezvous.evaluation.fusion.summary import fusion_figures, fusion_table
from rendezvous.fusion.refinement import correlative_refiner
from rendezvous.geometry.se2 import SE2
from rendezvous.training.frame_error.pairs import MapPair
from tests.evaluation.toy_pairs import toy_pair
from tests.evaluation.toy_poses import mode, read_as
from tests.synthetic import synthetic_row

ROW = synthetic_row(np.random.default_rng(0), plan=0)


TRUTH = ROW["T_r0_r1_true"]


@pytest.fixture(scope="module")
def pair() -> MapPair:
    return toy_pair(0)


@pytest.mark.parametrize(
    ("off", "position_m", "least_iou", "most_iou"),
    [
        ((0.0, 0.0, 0.0), 0.0, 1.0, 1.0),
        # The meeting point is where T̃ puts robot 1; ten metres from the origin of m0 the error is no larger.
        ((0.3, -0.4, 0.2), 0.5, 0.0, 0.85),
        # Maps agree within a cell and no more.
        *(((0.04, 0.0, 0.0), 0.04, 0.98, 1.0), ((0.16, 0.0, 0.0), 0.16, 0.0, 0.85)),
    ],
)
def test_a_relative_pose_leaves_its_error_at_the_meeting_point(pair, off, position_m, least_iou, most_iou):
    found = run_rendezvous(pair, TRUTH, read_as(mode(TRUTH @ SE2(*off))), {"none": None})
    run, right = found[(ESTIMATED, "none")], found[(TRUE, "none")]
    assert math.hypot(run.error.x_m, run.error.y_m) == pytest.approx(position_m, abs=1e-9)
    assert run.error.yaw_rad == pytest.approx(off[2], abs=1e-9)
    assert least_iou <= run.iou <= most_iou
    assert right.error.as_array() == pytest.approx([0.0, 0.0, 0.0], abs=1e-9)
    assert right.iou == 1.0
    assert not run.refined
    assert not right.refined


def test_the_verdict_and_its_reasons_are_those_of_the_fusion(pair):
    right, wrong = (
        run_rendezvous(pair, TRUTH, read_as(mode(TRUTH @ off, sigma=0.01)), {"none": None})
        for off in (SE2.identity(), SE2(2.0, 1.0, 0.7))
    )
    assert (right[(ESTIMATED, "none")].accepted, right[(ESTIMATED, "none")].reasons) == (True, ())
    assert not wrong[(ESTIMATED, "none")].accepted
    assert wrong[(ESTIMATED, "none")].reasons


def test_maps_mend_a_wrong_relative_pose(pair):
    read = read_as(mode(TRUTH @ SE2(0.2, -0.2, 0.1), sigma=0.2))
    found = run_rendezvous(pair, TRUTH, read, {"none": None, "correlative": correlative_refiner})
    alone, mended = found[(ESTIMATED, "none")], found[(ESTIMATED, "correlative")]
    assert mended.refined
    assert math.hypot(mended.error.x_m, mended.error.y_m) < 0.06
    assert mended.iou > alone.iou


def test_a_robot_that_is_not_found_makes_no_map_but_counts(pair):
    found = run_rendezvous(pair, TRUTH, read_as(), {"none": None})
    run = found[(ESTIMATED, "none")]
    assert (run.T_m0_m1, run.reasons, run.accepted) == (None, ("a toy",), False)
    assert found[(TRUE, "none")].T_m0_m1 is not None
    table = fusion_table([found], np.array([pair.overlap]))
    overall = fusion_figures(table[table.source == ESTIMATED]).overall
    assert (overall.made.count, overall.success.count, overall.made.of, overall.success.of) == (0, 0, 1, 1)
    assert overall.iou_mean is None


def test_with_the_true_pose_there_is_no_covariance_to_tell():
    estimated = [(ESTIMATED, name) for name in ("none", "learned", "auto")]
    assert runs_of(("auto", "none", "learned")) == (*estimated, (TRUE, "none"), (TRUE, "learned"))


@pytest.mark.parametrize("modes", [(mode(TRUTH),), ()])
def test_outcomes_survive_json(pair, modes):
    found = run_rendezvous(pair, TRUTH, read_as(*modes), {"none": None})
    assert RendezvousOutcome.from_json(found.to_json()) == found
