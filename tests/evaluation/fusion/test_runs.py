from __future__ import annotations

import math
from dataclasses import replace

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

REFINERS = {"none": None, "correlative": correlative_refiner}


@pytest.fixture(scope="module")
def meeting() -> tuple[MapPair, SE2]:
    """A pair of maps with robot 0's pose, and the true relative pose."""
    row = synthetic_row(np.random.default_rng(0), plan=0)
    return replace(toy_pair(0), T_m0_r0=row["T_m0_r0"]), row["T_r0_r1_true"]


def _figures(found: list[RendezvousOutcome], overlap: float):
    """Figures of the estimated pose alone."""
    table = fusion_table(found, np.full(len(found), overlap))
    return fusion_figures(table[(table.source == ESTIMATED) & (table.method == "none")])


def test_the_true_relative_pose_gives_the_true_map(meeting):
    pair, true = meeting
    found = run_rendezvous(pair, true, read_as(mode(true)), {"none": None})
    for source in (ESTIMATED, TRUE):
        run = found[(source, "none")]
        assert run.error.as_array() == pytest.approx([0.0, 0.0, 0.0], abs=1e-9)
        assert run.iou == 1.0
        assert not run.refined


def test_a_wrong_relative_pose_leaves_its_error_at_the_meeting_point(meeting):
    pair, true = meeting
    found = run_rendezvous(pair, true, read_as(mode(true @ SE2(0.3, -0.4, 0.2))), {"none": None})
    run = found[(ESTIMATED, "none")]
    # The meeting point is where T̃ puts robot 1; ten metres from the origin of m0 the error is no larger.
    assert math.hypot(run.error.x_m, run.error.y_m) == pytest.approx(0.5, abs=1e-9)
    assert run.error.yaw_rad == pytest.approx(0.2)
    assert run.iou < 0.9
    assert found[(TRUE, "none")].iou == 1.0


def test_maps_agree_within_a_cell_and_no_more(meeting):
    pair, true = meeting
    within, beyond = (
        run_rendezvous(pair, true, read_as(mode(true @ SE2(off_m, 0.0, 0.0))), {"none": None})[
            (ESTIMATED, "none")
        ].iou
        for off_m in (0.04, 0.16)
    )
    assert within > 0.98
    assert beyond < 0.85


def test_maps_mend_a_wrong_relative_pose(meeting):
    pair, true = meeting
    found = run_rendezvous(pair, true, read_as(mode(true @ SE2(0.2, -0.2, 0.1), sigma=0.2)), REFINERS)
    alone, mended = (found[(ESTIMATED, name)] for name in REFINERS)
    assert mended.refined
    assert math.hypot(mended.error.x_m, mended.error.y_m) < 0.06
    assert mended.iou > alone.iou


def test_a_robot_that_is_not_found_makes_no_map_but_counts(meeting):
    pair, true = meeting
    found = run_rendezvous(pair, true, read_as(), {"none": None})
    run = found[(ESTIMATED, "none")]
    assert run.T_m0_m1 is None
    assert run.reasons == ("a toy",)
    assert not run.accepted
    assert found[(TRUE, "none")].T_m0_m1 is not None
    figures = _figures([found], pair.overlap)
    assert (figures.overall.made.count, figures.overall.made.of) == (0, 1)
    assert (figures.overall.success.count, figures.overall.success.of) == (0, 1)
    assert figures.overall.iou_mean is None


def test_with_the_true_pose_there_is_no_covariance_to_tell():
    runs = runs_of(("auto", "none", "learned"))
    assert runs == (
        (ESTIMATED, "none"),
        (ESTIMATED, "learned"),
        (ESTIMATED, "auto"),
        (TRUE, "none"),
        (TRUE, "learned"),
    )


def test_outcomes_survive_json(meeting):
    pair, true = meeting
    for pose in (read_as(mode(true)), read_as()):
        found = run_rendezvous(pair, true, pose, {"none": None})
        again = RendezvousOutcome.from_json(found.to_json())
        assert again == found
