"""Rendezvous as the system fuses them: red map 0, blue map 1 where the transform puts it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import pandas as pd

from rendezvous.evaluation.frame_error.estimates import SUCCESS_M, SUCCESS_RAD
from rendezvous.evaluation.frame_error.gallery import overlay, shown_once, square_around
from rendezvous.evaluation.fusion.runs import ESTIMATED, NONE, FusionRun, RendezvousOutcome
from rendezvous.geometry.camera import Image
from rendezvous.training.frame_error.pairs import MapPair


@dataclass(frozen=True, slots=True, kw_only=True)
class FusionShown:
    """One rendezvous of the gallery."""

    why: str
    # pair_id, overlap: its pair of maps.
    pair_id: str
    overlap: float
    outcome: RendezvousOutcome  # of all its runs
    truth: Image  # picture of the true fusion
    panels: Sequence[tuple[FusionRun, Image]]  # a picture for each run that is drawn


def fusion_shown(
    why: str, pair: MapPair, outcome: RendezvousOutcome, runs: Sequence[FusionRun]
) -> FusionShown:
    """The true fusion, that by the estimated pose alone, and those by some runs, all at one scale.

    Runs without a fused map are left out.
    """
    view = square_around(pair)
    drawn = {(ESTIMATED, NONE), *runs}
    return FusionShown(
        why=why,
        pair_id=pair.pair_id,
        overlap=pair.overlap,
        outcome=outcome,
        truth=overlay(pair, pair.T_m0_m1, *view),
        panels=[
            ((source, method), overlay(pair, found.T_m0_m1, *view))
            for source, method, found in outcome.runs
            if (source, method) in drawn and found.T_m0_m1 is not None
        ],
    )


def best_run(table: pd.DataFrame, shipped: FusionRun) -> FusionRun:
    """The system as it ships if it was measured, else the run of most successes with estimated poses."""
    successes = table[table.source == ESTIMATED].groupby(["source", "method"], sort=False).success.sum()
    return shipped if shipped in successes.index else successes.idxmax()


def chosen_rendezvous(run: pd.DataFrame) -> list[tuple[str, int]]:
    """Reasons and numbers of a run's best, median and worst fused maps.

    They are ordered by the sum of both errors, each divided by what counts as a success.
    """
    fused = run[run.made]
    off = fused.position_m / SUCCESS_M + fused.heading_rad / SUCCESS_RAD
    order = off.sort_values(kind="stable").index
    middle = order[len(order) // 2 :][:1]
    return shown_once({"best": order[:1], "median": middle, "worst": order[-1:]})
