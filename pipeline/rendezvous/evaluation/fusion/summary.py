"""The whole system's figures: errors of T̂, agreement of fused maps, verdicts; in total and by overlap."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd

from rendezvous.alignment.estimate import WRONG_M, WRONG_RAD
from rendezvous.evaluation.frame_error.estimates import SUCCESS_M, SUCCESS_RAD, overlap_bins
from rendezvous.evaluation.fusion.runs import FusionOutcome, RendezvousOutcome
from rendezvous.evaluation.relative_pose.summary import Share, Tail
from rendezvous.geometry.se2 import Array


@dataclass(frozen=True, slots=True, kw_only=True)
class FusionGroup:
    """Figures of some rendezvous."""

    made: Share  # those with a fused map, because the robot was found
    success: Share  # those within SUCCESS_M and SUCCESS_RAD, of all
    # Absolute Δx [m], Δy [m], Δψ [rad] of the fused; None without any, as the next four.
    median: tuple[float, float, float] | None
    # position_m, heading_rad: of the fused.
    position_m: Tail | None
    heading_rad: Tail | None
    # iou_mean, iou_median: of the fused whose maps have occupied cells.
    iou_mean: float | None
    iou_median: float | None


@dataclass(frozen=True, slots=True, kw_only=True)
class FusionFigures:
    """One run's figures."""

    overall: FusionGroup  # all rendezvous
    by_overlap: dict[str, FusionGroup]  # by `OVERLAP_BINS`, without empty bins
    accepted: Share  # of all
    wrong_accepted: Share  # those of the accepted that are off by more than WRONG_M or WRONG_RAD
    wrong_uncertain: Share  # the same of the fused maps that are not accepted
    refined: Share  # those of the fused that the maps helped to align
    # duration_median_s, duration_p95_s: of the fused, from the pose to the map; None without any.
    duration_median_s: float | None
    duration_p95_s: float | None


def fusion_table(outcomes: Sequence[RendezvousOutcome], overlap: Array) -> pd.DataFrame:
    """One row for each run of each rendezvous, whose number is the index.

    Columns: source, method; overlap and `overlaps`, its bin; made, accepted, refined, duration_s; and,
    NaN or False without a fused map, dx_m, dy_m, dyaw_rad of the error; position_m, heading_rad; iou;
    success (within SUCCESS_M and SUCCESS_RAD) and wrong (beyond WRONG_M or WRONG_RAD).

    Args:
        outcomes: of N rendezvous.
        overlap: (N,) of their maps.
    """
    rows = [
        {"number": number, "source": source, "method": method, **_columns(outcome)}
        for number, rendezvous in enumerate(outcomes)
        for source, method, outcome in rendezvous.runs
    ]
    table = pd.DataFrame(rows).set_index("number")
    table["overlap"] = overlap[table.index]
    table["overlaps"] = overlap_bins(table["overlap"])
    table["position_m"], table["heading_rad"] = np.hypot(table.dx_m, table.dy_m), table.dyaw_rad.abs()
    table["success"] = (table.position_m <= SUCCESS_M) & (table.heading_rad <= SUCCESS_RAD)
    table["wrong"] = (table.position_m > WRONG_M) | (table.heading_rad > WRONG_RAD)
    return table


def _columns(outcome: FusionOutcome) -> dict[str, object]:
    dx_m, dy_m, dyaw_rad = [math.nan] * 3 if outcome.error is None else outcome.error.as_array()
    return {
        "made": outcome.error is not None,
        "accepted": outcome.accepted,
        "refined": outcome.refined,
        "duration_s": outcome.duration_s,
        "dx_m": dx_m,
        "dy_m": dy_m,
        "dyaw_rad": dyaw_rad,
        "iou": math.nan if outcome.iou is None else outcome.iou,
    }


def fusion_figures(run: pd.DataFrame) -> FusionFigures:
    """All figures of one run, from its rows of `fusion_table`."""
    fused, by_overlap = run[run.made], run.groupby("overlaps", observed=True)
    return FusionFigures(
        overall=_group(run),
        by_overlap={str(label): _group(rows) for label, rows in by_overlap},
        accepted=Share.true(run.accepted),
        wrong_accepted=Share.true(run.wrong[run.accepted]),
        wrong_uncertain=Share.true(fused.wrong[~fused.accepted]),
        refined=Share.true(fused.refined),
        duration_median_s=_known(fused.duration_s.median()),
        duration_p95_s=_known(fused.duration_s.quantile(0.95)),
    )


def _group(rows: pd.DataFrame) -> FusionGroup:
    fused = rows[rows.made]
    median = fused[["dx_m", "dy_m", "dyaw_rad"]].abs().median()
    return FusionGroup(
        made=Share.true(rows.made),
        success=Share.true(rows.success),
        median=tuple(median) if len(fused) else None,
        position_m=Tail.of(fused.position_m),
        heading_rad=Tail.of(fused.heading_rad),
        iou_mean=_known(fused.iou.mean()),
        iou_median=_known(fused.iou.median()),
    )


def _known(value: float) -> float | None:
    return None if math.isnan(value) else float(value)
