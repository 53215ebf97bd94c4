"""Error against training samples, and whether training had come to its end."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from rendezvous.geometry.se2 import Array

STILL_FALLING = 0.05
"""A validation error that fell by more than this share over the last quarter of the samples still falls."""


@dataclass(frozen=True, slots=True, kw_only=True)
class TrainingCurve:
    """What validation found while one model was trained.

    Attributes:
        samples: (P,) seen.
        position_m: (P,) mean absolute error in x and in y, averaged.
        yaw_rad: (P,) mean absolute error in heading.
        minutes: of training, in all.
    """

    samples: Array
    position_m: Array
    yaw_rad: Array
    minutes: float

    @staticmethod
    def from_points(points: Sequence[Mapping[str, float]]) -> TrainingCurve:
        """From the points that `train` writes."""
        xy_m = [(point["error_x_m"], point["error_y_m"]) for point in points]
        return TrainingCurve(
            samples=np.array([point["samples"] for point in points], dtype=np.float64),
            position_m=np.array(xy_m, dtype=np.float64).reshape(-1, 2).mean(axis=1),
            yaw_rad=np.array([point["error_yaw_rad"] for point in points], dtype=np.float64),
            minutes=points[-1]["elapsed_s"] / 60.0 if points else 0.0,
        )

    @property
    def converged(self) -> bool | None:
        """Whether the error has all but stopped to fall; None where there are too few points to tell.

        The median point of the last quarter of the samples against that of the quarter before, of two points
        the lower one: at some points a single pair on which the model fails raises the mean by half.
        """
        if len(self.samples) < 4:
            return None
        spent = self.samples / self.samples[-1]
        last, before = spent > 0.75, (spent > 0.5) & (spent <= 0.75)
        if not before.any():
            return None
        return all(
            _lower_median(error[last]) >= (1.0 - STILL_FALLING) * _lower_median(error[before])
            for error in (self.position_m, self.yaw_rad)
        )

    def to_json(self) -> dict[str, Any]:
        """Values as JSON holds them."""
        return {
            "samples": self.samples.tolist(),
            "position_m": self.position_m.tolist(),
            "yaw_rad": self.yaw_rad.tolist(),
            "minutes": self.minutes,
        }

    @staticmethod
    def from_json(fields: Mapping[str, Any]) -> TrainingCurve:
        """Inverse of `to_json`."""
        columns = {
            name: np.array(fields[name], dtype=np.float64) for name in ("samples", "position_m", "yaw_rad")
        }
        return TrainingCurve(**columns, minutes=float(fields["minutes"]))


def doubt(curve: TrainingCurve | None) -> str:
    """What there is to say against a row with such a curve, in words; empty if training came to its end."""
    converged = None if curve is None else curve.converged
    if converged is None:
        return "convergence not known"
    return "" if converged else "not converged"


def _lower_median(values: Array) -> float:
    return float(np.quantile(values, 0.5, method="lower"))
