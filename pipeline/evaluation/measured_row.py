"""A method's figures together with what they were measured on: a row that can be kept and shown again."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from typing import Any

from pipeline.errors import StoreError
from pipeline.evaluation.summary import Summary
from pipeline.evaluation.training_curve import TrainingCurve

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

    def same_range(self, other: Conditions) -> bool:
        """Whether frame errors were drawn from the same range, so that errors can stand in one table."""
        return (self.xy_range_m, self.yaw_range_deg) == (other.xy_range_m, other.yaw_range_deg)


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
    """One method under some conditions; `training` is None for what is not learned."""

    method: str
    conditions: Conditions
    summary: Summary
    training: Training | None

    @property
    def has_learned(self) -> bool:
        """Whether the mean error is well below that of answering zero: half of the range's half width."""
        zero_m = 0.5 * self.conditions.xy_range_m
        x_m, y_m, _ = (mean.value for mean in self.summary.overall.mean)
        return 0.5 * (x_m + y_m) < _LEARNED_SHARE * zero_m

    def file_name(self) -> str:
        """Under which the row is kept: the latest of each method and range."""
        c = self.conditions
        return f"{self.method}-{c.xy_range_m:g}m-{c.yaw_range_deg:g}deg.json"

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
            )
        except (KeyError, TypeError, ValueError, AttributeError) as error:
            raise StoreError(
                f"{where}: no recorded row ({error}); `rendezvous evaluate --record` writes it anew"
            ) from error
