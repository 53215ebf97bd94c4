"""A method's figures together with what they were measured on: a row that can be kept and shown again."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from typing import Any

from rendezvous.errors import StoreError
from rendezvous.evaluation.frame_error.summary import Summary
from rendezvous.evaluation.frame_error.training_curve import TrainingCurve, doubt

_FORMAT = 1
_LEARNED_SHARE = 0.8


@dataclass(frozen=True, slots=True, kw_only=True)
class Conditions:
    """What all methods of one evaluation were measured on.

    Attributes:
        split: of the dataset.
        pairs, plans: how many.
        data_digest: of the pairs' content.
        perturbation_digest: of the frame errors that were drawn.
        seed: of them.
        xy_range_m, yaw_range_deg: half widths from which they were drawn, uniformly.
        commit: of the code; empty if that is not known.
        hardware: where.
    """

    split: str
    pairs: int
    plans: int
    data_digest: str
    perturbation_digest: str
    seed: int
    xy_range_m: float
    yaw_range_deg: float
    commit: str
    hardware: str

    def comparable(self, other: Conditions) -> bool:
        """Whether split and range of the frame errors are the same, so that errors can stand in one table."""
        mine, others = ((c.split, c.xy_range_m, c.yaw_range_deg) for c in (self, other))
        return mine == others

    def same_pairs(self, other: Conditions) -> bool:
        """Whether the very same pairs were measured, wrong by the same frame errors."""
        mine, others = ((c.split, c.data_digest, c.perturbation_digest) for c in (self, other))
        return mine == others

    def file_name(self, method: str) -> str:
        """Under which a method's row is kept: the latest of each split and range."""
        split = "" if self.split == "test" else f"-{self.split}"
        return f"{method}-{self.xy_range_m:g}m-{self.yaw_range_deg:g}deg{split}.json"


@dataclass(frozen=True, slots=True, kw_only=True)
class Training:
    """How a learned method came about.

    Attributes:
        seed: of weights and samples.
        samples: seen.
        minutes: of training; None if no curve was found beside the weights.
        data: the dataset's folder, as it was called there.
        pairs: to train on.
        plans: they are from.
        weights_digest: of the file.
        curve: error against samples; None if none was found beside the weights.
    """

    seed: int
    samples: int
    minutes: float | None
    data: str
    pairs: int
    plans: int
    weights_digest: str
    curve: TrainingCurve | None


@dataclass(frozen=True, slots=True, kw_only=True)
class MeasuredRow:
    """One method under some conditions.

    Attributes:
        method: its name.
        conditions: what it was measured on.
        summary: its figures.
        training: None for what is not learned.
        plans_trained_on: how many of the measured floor plans it was trained on; None if that is not known,
            or if it is not learned.
    """

    method: str
    conditions: Conditions
    summary: Summary
    training: Training | None
    plans_trained_on: int | None = None

    @property
    def not_learned(self) -> tuple[str, ...]:
        """Of `position` and `heading`, whose mean error is not well below that of answering zero: half of the
        range's half width."""
        x_m, y_m, yaw_rad = (mean.value for mean in self.summary.overall.mean)
        zero_m, zero_rad = 0.5 * self.conditions.xy_range_m, math.radians(0.5 * self.conditions.yaw_range_deg)
        errors = {"position": (0.5 * (x_m + y_m), zero_m), "heading": (yaw_rad, zero_rad)}
        return tuple(name for name, (error, zero) in errors.items() if error >= _LEARNED_SHARE * zero)

    @property
    def doubts(self) -> tuple[str, ...]:
        """Reasons to doubt the figures of a learned method, in words."""
        if self.training is None:
            return ()
        known, plans = self.plans_trained_on, self.conditions.plans
        missed = f"has not learned {' or '.join(self.not_learned)}" if self.not_learned else ""
        trained = f"trained on {known} of these {plans} plans" if known else ""
        return tuple(filter(None, (missed or doubt(self.training.curve), trained)))

    def to_json(self) -> dict[str, Any]:
        """Values as JSON holds them."""
        training = None
        if self.training is not None:
            told = {field.name: getattr(self.training, field.name) for field in fields(Training)}
            training = {**told, "curve": self.training.curve and self.training.curve.to_json()}
        return {
            "format": _FORMAT,
            "method": self.method,
            "conditions": asdict(self.conditions),
            "training": training,
            "plans_trained_on": self.plans_trained_on,
            "summary": self.summary.to_json(),
        }

    @staticmethod
    def from_json(values: Mapping[str, Any], *, where: str) -> MeasuredRow:
        """Inverse of `to_json`.

        Raises:
            StoreError: these are not the values of a row.
        """
        try:
            if values["format"] != _FORMAT:
                raise StoreError(f"{where}: a recorded row of format {values['format']}; must be {_FORMAT}")
            training = values["training"]
            if training is not None:
                curve = training["curve"]
                training = Training(**{**training, "curve": curve and TrainingCurve.from_json(curve)})
            return MeasuredRow(
                method=values["method"],
                conditions=Conditions(**values["conditions"]),
                summary=Summary.from_json(values["summary"]),
                training=training,
                # Rows that were recorded before this was counted have no such key.
                plans_trained_on=values.get("plans_trained_on"),
            )
        except (KeyError, TypeError, ValueError, AttributeError) as error:
            raise StoreError(
                f"{where}: no recorded row ({error}); delete it, and `rendezvous evaluate --record` makes it "
                "anew"
            ) from error
