"""How a network was trained: error against samples, and whether that had converged."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from rendezvous.evaluation.json_record import Column, JsonRecord
from rendezvous.geometry.se2 import Array

STILL_FALLING = 0.05
"""An error that fell by more than this share over the last quarter of the samples is still falling."""


@dataclass(frozen=True, slots=True, kw_only=True)
class TrainingCurve(JsonRecord):
    """Validation errors while one model was trained."""

    samples: Column  # (P,) seen so far
    position_m: Column  # (P,) mean absolute error in x and in y, averaged
    yaw_rad: Column  # (P,) mean absolute error in heading
    minutes: float  # of training in total

    @staticmethod
    def from_points(points: Sequence[Mapping[str, float]]) -> TrainingCurve:
        """From the points of `curve.json`, which `train` writes."""
        xy_m = [(point["error_x_m"], point["error_y_m"]) for point in points]
        return TrainingCurve(
            samples=np.array([point["samples"] for point in points], dtype=np.float64),
            position_m=np.array(xy_m, dtype=np.float64).reshape(-1, 2).mean(axis=1),
            yaw_rad=np.array([point["error_yaw_rad"] for point in points], dtype=np.float64),
            minutes=points[-1]["elapsed_s"] / 60.0 if points else 0.0,
        )

    @property
    def converged(self) -> bool | None:
        """Whether the error has all but stopped falling; None if there are too few points to say.

        Compares the median over the last quarter of the samples with that over the quarter before, the lower
        of the two middle points: at some points a single failed pair raises the mean by half.
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


@dataclass(frozen=True, slots=True, kw_only=True)
class Training:
    """How a network was trained."""

    seed: int  # of weights and samples
    samples: int  # number seen
    minutes: float | None  # of training; None without a curve
    data: str  # the dataset's folder, as it was called there
    # pairs, plans: numbers of training pairs and of their floor plans.
    pairs: int
    plans: int
    weights_digest: str  # SHA-256 of the file
    # Error against samples; None if it was neither in the weights nor beside them.
    curve: TrainingCurve | None


def doubt(curve: TrainingCurve | None) -> str:
    """Reason to doubt a row with such a curve, in words; '' if training converged."""
    converged = None if curve is None else curve.converged
    if converged is None:
        return "convergence not known"
    return "" if converged else "not converged"


def _lower_median(values: Array) -> float:
    return float(np.quantile(values, 0.5, method="lower"))
