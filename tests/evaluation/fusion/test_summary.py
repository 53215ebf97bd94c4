"""Figures of fusions, from outcomes made of numbers."""

from __future__ import annotations

import math

import numpy as np
import pytest

from rendezvous.evaluation.fusion.gallery import best_run, chosen_rendezvous
from rendezvous.evaluation.fusion.runs import AUTO, ESTIMATED, NONE, FusionOutcome, RendezvousOutcome
from rendezvous.evaluation.fusion.summary import fusion_figures, fusion_table
from rendezvous.geometry.se2 import SE2

NOT_MADE = FusionOutcome(reasons=("a toy",))


def fused(
    x_m: float, yaw_deg: float = 0.0, *, y_m=0.0, accepted=True, iou=0.5, refined=True, duration_s=1.0
) -> FusionOutcome:
    return FusionOutcome(
        T_m0_m1=SE2.identity(),
        error=SE2(x_m, y_m, math.radians(yaw_deg)),
        iou=iou,
        accepted=accepted,
        reasons=(),
        refined=refined,
        duration_s=duration_s,
    )


def table(*outcomes: FusionOutcome, overlap=0.3):
    found = [
        RendezvousOutcome(pair_id=f"pair-{i}", runs=((ESTIMATED, NONE, outcome),))
        for i, outcome in enumerate(outcomes)
    ]
    return fusion_table(found, np.broadcast_to(overlap, len(found)))


def test_a_success_is_within_both_bounds_and_a_wrong_map_beyond_either():
    outcomes = [
        *(fused(0.29, 2.9), fused(-0.29, -2.9), fused(0.31), fused(0.0, -3.1)),
        *(fused(0.49, 4.9), fused(0.51), fused(0.0, -5.1), fused(0.4, y_m=0.4), NOT_MADE),
    ]
    found = table(*outcomes)
    assert np.flatnonzero(found.success).tolist() == [0, 1]
    assert np.flatnonzero(found.wrong).tolist() == [5, 6, 7]
    assert found.made.tolist() == [True] * 8 + [False]


def test_verdicts_are_counted_against_the_errors():
    right, wrong = fused(0.1), fused(1.0)
    doubted = [fused(1.0, accepted=False), fused(1.0, accepted=False), fused(0.1, accepted=False)]
    figures = fusion_figures(table(right, right, right, wrong, *doubted, NOT_MADE))
    assert (figures.accepted.count, figures.accepted.of) == (4, 8)
    assert (figures.wrong_accepted.count, figures.wrong_accepted.of) == (1, 4)
    assert (figures.wrong_uncertain.count, figures.wrong_uncertain.of) == (2, 3)


def test_figures_are_those_of_the_fused():
    outcomes = [
        fused(0.1, 1.0, iou=0.2, duration_s=1.0),
        fused(-0.2, -2.0, iou=0.3, duration_s=2.0, refined=False),
        fused(0.6, 6.0, iou=None, duration_s=6.0),
        fused(0.4, 4.0, iou=1.0, duration_s=4.0),
    ]
    figures = fusion_figures(table(*outcomes, NOT_MADE))
    overall = figures.overall
    assert (overall.made.count, overall.made.of) == (4, 5)
    assert overall.median == pytest.approx((0.3, 0.0, math.radians(3.0)))
    assert (overall.position_m.median, overall.position_m.largest) == pytest.approx((0.3, 0.6))
    assert overall.heading_rad.p95 == pytest.approx(math.radians(5.7))
    assert (overall.iou_mean, overall.iou_median) == pytest.approx((0.5, 0.3))
    assert (figures.refined.count, figures.refined.of) == (3, 4)
    assert (figures.duration_median_s, figures.duration_p95_s) == pytest.approx((3.0, 5.7))


def test_groups_are_bins_of_overlap_that_have_a_rendezvous():
    figures = fusion_figures(table(*[fused(0.0)] * 3, overlap=[0.05, 0.1, 0.2]))
    assert [(label, group.made.of) for label, group in figures.by_overlap.items()] == [
        *(("< 0.1", 1), ("0.1–0.25", 2))
    ]


def test_the_best_the_median_and_the_worst_by_both_errors_are_shown_once():
    # Each error counts as a share of what is a success: 0.3 m and 3°.
    run = table(fused(0.1, 6.0), NOT_MADE, fused(0.2), fused(0.6, 6.0), fused(0.1), fused(0.2, 1.0))
    assert chosen_rendezvous(run) == [("best", 4), ("median", 5), ("worst", 3)]
    assert chosen_rendezvous(table(fused(0.1))) == [("best", 0)]
    assert chosen_rendezvous(table(NOT_MADE)) == []


def test_the_shipped_run_is_the_best_if_measured_and_else_that_of_most_successes():
    outcomes = {NONE: fused(0.1), "orb": fused(1.0), AUTO: fused(1.0)}
    runs = tuple((ESTIMATED, method, outcome) for method, outcome in outcomes.items())
    found = fusion_table([RendezvousOutcome(pair_id="pair", runs=runs)], np.array([0.3]))
    assert best_run(found, (ESTIMATED, AUTO)) == (ESTIMATED, AUTO)
    assert best_run(found[found.method != AUTO], (ESTIMATED, AUTO)) == (ESTIMATED, NONE)
