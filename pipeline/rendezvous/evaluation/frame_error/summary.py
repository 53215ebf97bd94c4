"""A method's figures, from its rows of an `outcome_table`, and who is better than whom."""

from __future__ import annotations

from dataclasses import dataclass

import pandas as pd

from rendezvous.evaluation.frame_error.calibration import Calibration, Warnings, calibration, warnings
from rendezvous.evaluation.json_record import JsonRecord
from rendezvous.evaluation.statistics import Interval, bootstrap_mean, wilson_interval
from rendezvous.geometry.se2 import Array


@dataclass(frozen=True, slots=True, kw_only=True)
class Accuracy:
    """Errors over a set of pairs; a failure counts as no correction, and never as a success."""

    count: int  # of pairs
    mean: tuple[Interval, Interval, Interval]  # mean absolute x [m], y [m], yaw [rad] of θ̂⁻¹ θ
    median: tuple[float, float, float]  # of the same
    # position_m, heading_rad: mean distance and absolute angle.
    position_m: Interval
    heading_rad: Interval
    # position_p95_m, heading_p95_rad: their 95th percentiles.
    position_p95_m: float
    heading_p95_rad: float
    meeting_m: Interval  # mean distance by which T̂ misplaces robot 1
    success: Interval  # share within SUCCESS_M and SUCCESS_RAD
    failures: float  # share without an estimate


@dataclass(frozen=True, slots=True, kw_only=True)
class Summary(JsonRecord):
    """One method's figures."""

    overall: Accuracy  # over all pairs
    by_overlap: dict[str, Accuracy | None]  # by label of `OVERLAP_BINS`; None for a bin without pairs
    calibration: Calibration | None  # over all estimates with a covariance; None if there are none
    calibration_unflagged: Calibration | None  # the same over the estimates that the method does not flag
    warnings: Warnings  # how well it flags errors
    # duration_median_s, duration_p95_s: per pair.
    duration_median_s: float
    duration_p95_s: float


def summary(outcomes: pd.DataFrame, weights: Array) -> Summary:
    """All figures of one method.

    Args:
        outcomes: the method's N rows of an `outcome_table`.
        weights: (R, N) of the resamples, the same for all methods.
    """
    bins = outcomes.groupby("overlaps", observed=False)
    return Summary(
        overall=accuracy(outcomes, weights),
        by_overlap={str(name): accuracy(rows, weights) if len(rows) else None for name, rows in bins},
        calibration=calibration(outcomes),
        calibration_unflagged=calibration(outcomes[~outcomes["flagged"]]),
        warnings=warnings(outcomes),
        duration_median_s=float(outcomes["duration_s"].median()),
        duration_p95_s=float(outcomes["duration_s"].quantile(0.95)),
    )


def accuracy(outcomes: pd.DataFrame, weights: Array) -> Accuracy:
    """Errors over at least one row of an `outcome_table`; (R, N) weights of the resamples of all pairs."""
    chosen = weights[:, outcomes.index]
    components = outcomes[["x_m", "y_m", "yaw_rad"]].abs()
    x, y, yaw = (bootstrap_mean(components[name].to_numpy(), chosen) for name in components)
    median = components.median()
    means = {
        name: bootstrap_mean(outcomes[name].to_numpy(), chosen)
        for name in ("position_m", "heading_rad", "meeting_m")
    }
    return Accuracy(
        count=len(outcomes),
        mean=(x, y, yaw),
        median=(float(median["x_m"]), float(median["y_m"]), float(median["yaw_rad"])),
        **means,
        position_p95_m=float(outcomes["position_m"].quantile(0.95)),
        heading_p95_rad=float(outcomes["heading_rad"].quantile(0.95)),
        success=wilson_interval(outcomes["success"].sum(), len(outcomes)),
        failures=float(outcomes["failed"].mean()),
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class Comparison(JsonRecord):
    """Two methods on the same pairs: differences, better minus other, with paired intervals."""

    # better, other: names; `better` has the smaller mean position error.
    better: str
    other: str
    # position_m, heading_rad: of the mean errors; negative where `better` is better.
    position_m: Interval
    heading_rad: Interval
    success: Interval  # of the success rates; positive where `better` is better

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


def comparisons(outcomes: pd.DataFrame, weights: Array) -> list[Comparison]:
    """The best method against each other one; with every pair of methods, some would differ by chance."""
    best, *others = ranking(outcomes)
    rows = {name: found.sort_index() for name, found in outcomes.groupby("method")}
    return [
        Comparison(
            better=best,
            other=other,
            **{
                name: bootstrap_mean((rows[best][name].astype(float) - rows[other][name]).to_numpy(), weights)
                for name in ("position_m", "heading_rad", "success")
            },
        )
        for other in others
    ]


def ranking(outcomes: pd.DataFrame) -> list[str]:
    """Names of methods, the smallest mean position error first."""
    means = outcomes.groupby("method", sort=False)["position_m"].mean()
    return list(means.sort_values(kind="stable").index)
