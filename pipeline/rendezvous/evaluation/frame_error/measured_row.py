"""A method's figures and what they were measured on: a row that can be recorded and shown again."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from rendezvous.evaluation.frame_error.summary import Summary
from rendezvous.evaluation.frame_error.training_curve import Training, doubt
from rendezvous.evaluation.json_record import JsonRecord
from rendezvous.evaluation.report.recorded_figures import FORMAT, Conditions

_LEARNED_SHARE = 0.8


@dataclass(frozen=True, slots=True, kw_only=True)
class PairConditions(Conditions):
    """The pairs and frame errors on which all methods of one evaluation were measured."""

    pairs: int  # number of them
    perturbation_digest: str  # of the frame errors that were drawn
    # xy_range_m, yaw_range_deg: half widths of their uniform distribution.
    xy_range_m: float
    yaw_range_deg: float

    def comparable(self, other: PairConditions) -> bool:
        """Whether split and range of the frame errors are equal, so that errors can stand in one table."""
        mine, others = ((c.split, c.xy_range_m, c.yaw_range_deg) for c in (self, other))
        return mine == others

    def same_pairs(self, other: PairConditions) -> bool:
        """Whether the same pairs were measured with the same frame errors."""
        mine, others = ((c.split, c.data_digest, c.perturbation_digest) for c in (self, other))
        return mine == others

    def file_name(self, method: str) -> str:
        """The file that records the latest row of a method with this split and range."""
        return f"{method}-{self.xy_range_m:g}m-{self.yaw_range_deg:g}deg{self.split_suffix}.json"

    @property
    def measured_on(self) -> tuple[int, str]:
        """The number of pairs, and the noun."""
        return self.pairs, "pairs"


@dataclass(frozen=True, slots=True, kw_only=True)
class MeasuredRow(JsonRecord):
    """One method under some conditions."""

    method: str
    conditions: PairConditions  # what it was measured on
    training: Training | None  # None for a method without weights
    # Rows recorded before this was counted do not have it.
    # How many of the measured floor plans it was trained on; None if unknown, or if the method has no
    # weights.
    plans_trained_on: int | None = None
    summary: Summary  # its figures

    @property
    def name(self) -> str:
        """The method's name."""
        return self.method

    @property
    def not_learned(self) -> tuple[str, ...]:
        """Those of `position` and `heading` whose mean error is not well below that of answering zero, which
        is half of the range's half width."""
        x_m, y_m, yaw_rad = (mean.value for mean in self.summary.overall.mean)
        zero_m, zero_rad = 0.5 * self.conditions.xy_range_m, math.radians(0.5 * self.conditions.yaw_range_deg)
        errors = {"position": (0.5 * (x_m + y_m), zero_m), "heading": (yaw_rad, zero_rad)}
        return tuple(name for name, (error, zero) in errors.items() if error >= _LEARNED_SHARE * zero)

    @property
    def doubts(self) -> tuple[str, ...]:
        """Reasons to doubt the figures of a network, in words."""
        if self.training is None:
            return ()
        known, plans = self.plans_trained_on, self.conditions.plans
        missed = f"has not learned {' or '.join(self.not_learned)}" if self.not_learned else ""
        trained = f"trained on {known} of these {plans} plans" if known else ""
        return tuple(filter(None, (missed or doubt(self.training.curve), trained)))

    def to_json(self) -> dict[str, Any]:
        """JSON values, with the format."""
        return {"format": FORMAT, **JsonRecord.to_json(self)}
