"""What a method's outcomes come to: the figures of a table's row, and who is better than whom."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from rendezvous.evaluation.frame_error.calibration import Calibration, Warnings, calibration, warnings
from rendezvous.evaluation.frame_error.estimates import Outcomes, Pairs
from rendezvous.evaluation.statistics import Interval, bootstrap_mean, wilson_interval
from rendezvous.geometry.occupancy_grid import Mask
from rendezvous.geometry.se2 import Array

OVERLAP_EDGES = (0.1, 0.25, 0.5)
OVERLAP_BINS = ("< 0.1", "0.1–0.25", "0.25–0.5", "> 0.5")


@dataclass(frozen=True, slots=True, kw_only=True)
class Accuracy:
    """Errors over a set of pairs; a failure counts as no correction, and never as a success.

    Attributes:
        count: pairs.
        mean: mean absolute x [m], y [m], yaw [rad] of θ̂⁻¹ θ.
        median: of the same.
        position_m, heading_rad: mean distance and absolute angle.
        position_p95_m, heading_p95_rad: 95th percentiles of them.
        meeting_m: mean distance by which T̂ misplaces robot 1.
        success: share within SUCCESS_M and SUCCESS_RAD.
        failures: share without an estimate.
    """

    count: int
    mean: tuple[Interval, Interval, Interval]
    median: tuple[float, float, float]
    position_m: Interval
    heading_rad: Interval
    position_p95_m: float
    heading_p95_rad: float
    meeting_m: Interval
    success: Interval
    failures: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Summary:
    """One method's figures.

    Attributes:
        overall: over all pairs.
        by_overlap: by `OVERLAP_BINS`; None for a bin without pairs.
        calibration: over all estimates with a covariance; None if there are none.
        calibration_unflagged: the same over those that the method stands by.
        warnings: what it flags.
        duration_median_s, duration_p95_s: per pair.
    """

    overall: Accuracy
    by_overlap: tuple[Accuracy | None, ...]
    calibration: Calibration | None
    calibration_unflagged: Calibration | None
    warnings: Warnings
    duration_median_s: float
    duration_p95_s: float

    def to_json(self) -> dict[str, Any]:
        """Values as JSON holds them: null for what there is none of."""
        fields = asdict(self)
        fields["by_overlap"] = dict(zip(OVERLAP_BINS, fields["by_overlap"], strict=True))
        return dict(without_nan(fields))

    @staticmethod
    def from_json(fields: Mapping[str, Any]) -> Summary:
        """Inverse of `to_json`."""
        return Summary(
            **{
                **fields,
                "overall": _accuracy(fields["overall"]),
                "by_overlap": tuple(
                    None if (found := fields["by_overlap"][name]) is None else _accuracy(found)
                    for name in OVERLAP_BINS
                ),
                "calibration": _calibration(fields["calibration"]),
                "calibration_unflagged": _calibration(fields["calibration_unflagged"]),
                "warnings": Warnings(**{k: _interval(v) for k, v in fields["warnings"].items()}),
            }
        )


def summary(outcomes: Outcomes, pairs: Pairs, weights: Array) -> Summary:
    """All figures of one method.

    Args:
        outcomes: of N pairs.
        pairs: what they are.
        weights: (R, N) of the resamples, the same for all methods.
    """
    bins = np.digitize(pairs.overlap, OVERLAP_EDGES)
    everything = np.ones(len(outcomes), dtype=bool)
    return Summary(
        overall=accuracy(outcomes, everything, weights),
        by_overlap=tuple(
            accuracy(outcomes, bins == b, weights) if (bins == b).any() else None
            for b in range(len(OVERLAP_BINS))
        ),
        calibration=calibration(outcomes, everything),
        calibration_unflagged=calibration(outcomes, ~outcomes.flagged),
        warnings=warnings(outcomes),
        duration_median_s=float(np.median(outcomes.duration_s)),
        duration_p95_s=float(np.quantile(outcomes.duration_s, 0.95)),
    )


def accuracy(outcomes: Outcomes, chosen: Mask, weights: Array) -> Accuracy:
    """Errors of the chosen (N,) pairs; at least one."""
    error, chosen_weights = np.abs(outcomes.error[chosen]), weights[:, chosen]
    x, y, yaw = (bootstrap_mean(component, chosen_weights) for component in error.T)
    median = np.median(error, axis=0)
    position_m, heading_rad = outcomes.position_m[chosen], outcomes.heading_rad[chosen]
    return Accuracy(
        count=len(error),
        mean=(x, y, yaw),
        median=(float(median[0]), float(median[1]), float(median[2])),
        position_m=bootstrap_mean(position_m, chosen_weights),
        heading_rad=bootstrap_mean(heading_rad, chosen_weights),
        position_p95_m=float(np.quantile(position_m, 0.95)),
        heading_p95_rad=float(np.quantile(heading_rad, 0.95)),
        meeting_m=bootstrap_mean(outcomes.meeting_error_m[chosen], chosen_weights),
        success=wilson_interval(int(outcomes.success[chosen].sum()), len(error)),
        failures=float(outcomes.failed[chosen].mean()),
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class Comparison:
    """One method against another on the same pairs: differences, better minus other, with paired intervals.

    Attributes:
        better, other: names; `better` has the smaller mean position error.
        position_m, heading_rad: of the mean errors; negative where `better` is so.
        success: of the success rates; positive where `better` is so.
    """

    better: str
    other: str
    position_m: Interval
    heading_rad: Interval
    success: Interval

    @property
    def verdict(self) -> str:
        """What the intervals leave no doubt about, in words."""
        gains = {
            "position": self.position_m.scaled(-1.0),
            "heading": self.heading_rad.scaled(-1.0),
            "success": self.success,
        }
        sure = {name: gain.value for name, gain in gains.items() if gain.excludes_zero}
        better = ", ".join(name for name, gain in sure.items() if gain > 0.0)
        worse = ", ".join(name for name, gain in sure.items() if gain < 0.0)
        said = [f"better in {better}"] * bool(better) + [f"worse in {worse}"] * bool(worse)
        return "; ".join(said) or "no difference beyond doubt"

    def to_json(self) -> dict[str, Any]:
        """Values as JSON holds them."""
        return dict(without_nan(asdict(self)))


def comparisons(found: Mapping[str, Outcomes], weights: Array) -> list[Comparison]:
    """The best method against each other one: each two would be so many that some differ by chance."""
    best, *others = ranking(found)
    return [_comparison(best, other, found, weights) for other in others]


def ranking(found: Mapping[str, Outcomes]) -> list[str]:
    """Names from the smallest mean position error to the largest."""
    return sorted(found, key=lambda name: float(found[name].position_m.mean()))


def _comparison(a: str, b: str, found: Mapping[str, Outcomes], weights: Array) -> Comparison:
    one, two = found[a], found[b]
    success = one.success.astype(np.float64) - two.success
    return Comparison(
        better=a,
        other=b,
        position_m=bootstrap_mean(one.position_m - two.position_m, weights),
        heading_rad=bootstrap_mean(one.heading_rad - two.heading_rad, weights),
        success=bootstrap_mean(success, weights),
    )


def without_nan(value: Any) -> Any:
    """The same with null for numbers that JSON has not."""
    if isinstance(value, dict):
        return {key: without_nan(v) for key, v in value.items()}
    if isinstance(value, list | tuple):
        return [without_nan(v) for v in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _interval(fields: Mapping[str, float | None]) -> Interval:
    return Interval(**{key: math.nan if v is None else v for key, v in fields.items()})


def _accuracy(fields: Mapping[str, Any]) -> Accuracy:
    intervals = ("position_m", "heading_rad", "meeting_m", "success")
    x, y, yaw = (_interval(v) for v in fields["mean"])
    told = {key: _interval(fields[key]) for key in intervals}
    return Accuracy(**{**fields, **told, "mean": (x, y, yaw), "median": tuple(fields["median"])})


def _calibration(fields: Mapping[str, Any] | None) -> Calibration | None:
    if fields is None:
        return None
    finite = {k: math.inf if fields[k] is None else fields[k] for k in ("nees_mean", "spread_nll")}
    return Calibration(**{**fields, **finite, "coverage": tuple(_interval(v) for v in fields["coverage"])})
