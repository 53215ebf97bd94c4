"""What the whole system comes to: errors of T̂, agreement of fused maps, verdicts; in total and by overlap."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from rendezvous.alignment.estimate import WRONG_M, WRONG_RAD
from rendezvous.evaluation.frame_error.estimates import SUCCESS_M, SUCCESS_RAD
from rendezvous.evaluation.frame_error.summary import OVERLAP_BINS, OVERLAP_EDGES
from rendezvous.evaluation.fusion.runs import FusionOutcome, RendezvousOutcome, Run
from rendezvous.evaluation.relative_pose.summary import Share, Tail
from rendezvous.geometry.occupancy_grid import Mask
from rendezvous.geometry.se2 import Array


@dataclass(frozen=True)
class FusionOutcomes:
    """All outcomes of one run, as columns; N rendezvous in the order that all runs share."""

    rows: tuple[FusionOutcome, ...]

    @staticmethod
    def of(found: Sequence[RendezvousOutcome], run: Run) -> FusionOutcomes:
        """One run's column."""
        return FusionOutcomes(tuple(each.runs[run] for each in found))

    def __len__(self) -> int:
        return len(self.rows)

    @cached_property
    def made(self) -> Mask:
        """(N,) where there is a fused map."""
        return np.array([row.error is not None for row in self.rows], dtype=bool)

    @cached_property
    def error(self) -> Array:
        """(N, 3) components x [m], y [m], yaw [rad] of the frame error that is left; NaN without a map."""
        missing = np.full(3, np.nan)
        return np.array([missing if row.error is None else row.error.as_array() for row in self.rows])

    @cached_property
    def position_m(self) -> Array:
        """(N,) distance of its x and y."""
        return np.hypot(self.error[:, 0], self.error[:, 1])

    @cached_property
    def heading_rad(self) -> Array:
        """(N,) its absolute yaw."""
        return np.abs(self.error[:, 2])

    @cached_property
    def iou(self) -> Array:
        """(N,) agreement with the true fused map; NaN where none was made."""
        return np.array([np.nan if row.iou is None else row.iou for row in self.rows])

    @cached_property
    def success(self) -> Mask:
        """(N,) where T̂ is within SUCCESS_M and SUCCESS_RAD; never where none was made."""
        return (self.position_m <= SUCCESS_M) & (self.heading_rad <= SUCCESS_RAD)

    @cached_property
    def wrong(self) -> Mask:
        """(N,) where T̂ is off by more than WRONG_M or WRONG_RAD."""
        return (self.position_m > WRONG_M) | (self.heading_rad > WRONG_RAD)

    @cached_property
    def accepted(self) -> Mask:
        """(N,) where the verdict accepts the map."""
        return np.array([row.accepted for row in self.rows], dtype=bool)

    @cached_property
    def refined(self) -> Mask:
        """(N,) where the maps gave an estimate."""
        return np.array([row.refined for row in self.rows], dtype=bool)


@dataclass(frozen=True, slots=True, kw_only=True)
class FusionGroup:
    """Some rendezvous.

    Attributes:
        made: those with a fused map, the robot having been found.
        success: those within SUCCESS_M and SUCCESS_RAD, of all.
        median: absolute Δx [m], Δy [m], Δψ [rad] of the fused; None without one, as the next four.
        position_m, heading_rad: of the fused.
        iou_mean, iou_median: of the fused, of those whose maps have occupied cells.
    """

    made: Share
    success: Share
    median: tuple[float, float, float] | None
    position_m: Tail | None
    heading_rad: Tail | None
    iou_mean: float | None
    iou_median: float | None


@dataclass(frozen=True, slots=True, kw_only=True)
class FusionFigures:
    """One run's figures.

    Attributes:
        overall: all rendezvous.
        by_overlap: by `OVERLAP_BINS`; bins without a rendezvous are left out.
        accepted: of all.
        wrong_accepted: of the accepted, those off by more than WRONG_M or WRONG_RAD.
        wrong_uncertain: the same of the fused maps that are not accepted.
        refined: of the fused, those to whose alignment the maps said something.
        duration_median_s, duration_p95_s: of the fused, from the pose to the map; None without one.
    """

    overall: FusionGroup
    by_overlap: dict[str, FusionGroup]
    accepted: Share
    wrong_accepted: Share
    wrong_uncertain: Share
    refined: Share
    duration_median_s: float | None
    duration_p95_s: float | None


def fusion_figures(found: FusionOutcomes, overlap: Array) -> FusionFigures:
    """All figures of one run on rendezvous of some overlap (N,)."""
    everything, bins = np.ones(len(found), dtype=bool), np.digitize(overlap, OVERLAP_EDGES)
    durations_s = np.array([row.duration_s for row in found.rows])[found.made]
    return FusionFigures(
        overall=fusion_group(found, everything),
        by_overlap={
            label: fusion_group(found, bins == b) for b, label in enumerate(OVERLAP_BINS) if (bins == b).any()
        },
        accepted=Share.within(found.accepted, everything),
        wrong_accepted=Share.within(found.wrong, found.accepted),
        wrong_uncertain=Share.within(found.wrong, found.made & ~found.accepted),
        refined=Share.within(found.refined, found.made),
        duration_median_s=float(np.median(durations_s)) if len(durations_s) else None,
        duration_p95_s=float(np.quantile(durations_s, 0.95)) if len(durations_s) else None,
    )


def fusion_group(found: FusionOutcomes, chosen: Mask) -> FusionGroup:
    """Figures of the chosen (N,) rendezvous."""
    made = chosen & found.made
    median = np.median(np.abs(found.error[made]), axis=0) if made.any() else None
    iou = found.iou[made & np.isfinite(found.iou)]
    return FusionGroup(
        made=Share.within(found.made, chosen),
        success=Share.within(found.success, chosen),
        median=None if median is None else (float(median[0]), float(median[1]), float(median[2])),
        position_m=Tail.of(found.position_m[made]) if made.any() else None,
        heading_rad=Tail.of(found.heading_rad[made]) if made.any() else None,
        iou_mean=float(iou.mean()) if len(iou) else None,
        iou_median=float(np.median(iou)) if len(iou) else None,
    )
