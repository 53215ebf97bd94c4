"""The figures of an estimator of the relative pose: in total, and by distance, visibility and heading."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import pandas as pd

from rendezvous.evaluation.frame_error.calibration import LEVELS
from rendezvous.evaluation.statistics import Interval, wilson_interval

TARGET_VISIBILITY, TARGET_DISTANCE_M = 0.5, 2.5
TARGET_POSITION_M, TARGET_HEADING_RAD, TARGET_DETECTION = 0.05, math.radians(3.0), 0.95
"""The goal for images that show more than half of a near robot: medians at most, detections at least."""

DISTANCES = ("< 1 m", "1–1.75 m", "1.75–2.5 m", "2.5–3.5 m", "> 3.5 m")
VISIBILITIES = ("< 0.25", "0.25–0.5", "0.5–0.75", "> 0.75")
HEADINGS = (
    *("away", "away, left", "left", "towards, left"),
    *("towards", "towards, right", "right", "away, right"),
)
"""Sectors of 45°, the first centred on a robot that drives away."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Share:
    """A count, and what it is a part of."""

    count: int
    of: int

    @staticmethod
    def true(flags: pd.Series) -> Share:
        """The share of flags that are set; nulls are left out."""
        return Share(count=int(flags.sum()), of=int(flags.count()))

    @property
    def interval(self) -> Interval:
        """The share with Wilson's interval; NaN if it is a share of nothing."""
        return wilson_interval(self.count, self.of)


@dataclass(frozen=True, slots=True)
class Tail:
    """Quantiles of absolute errors, and the largest."""

    median: float
    p95: float
    p99: float
    largest: float

    @staticmethod
    def of(values: pd.Series) -> Tail | None:
        """Quantiles of all values that are not NaN; None without one."""
        return Tail(*values.quantile([0.5, 0.95, 0.99, 1.0])) if values.count() else None


@dataclass(frozen=True, slots=True, kw_only=True)
class PoseGroup:
    """Figures of a group of images that show the robot."""

    detected: Share  # images in which it was found
    # Absolute Δx [m], Δy [m], Δψ [rad] of the detections; None without any, as the next two.
    median: tuple[float, float, float] | None
    position_m: Tail | None  # distance of Δx and Δy
    heading_rad: Tail | None  # absolute Δψ
    confused: Share  # detections whose heading is off by more than a right angle
    told_otherwise: Share  # those of them of which another reading has the heading right


@dataclass(frozen=True, slots=True, kw_only=True)
class Coverage:
    """How well covariances predict the errors of detections."""

    inside: tuple[Share, ...]  # errors inside the ellipsoid of each probability of `calibration.LEVELS`
    nees_median: float  # 2.37 if covariances are right and errors normal, less for heavy tails
    nees_mean: float | None  # 3 if covariances are right; None if one is singular


@dataclass(frozen=True, slots=True, kw_only=True)
class WindowUse:
    """The frame error θ that the relative pose leaves in T̃, against the range of frame-error estimators."""

    offset_m: Tail  # distance of θ's x and y
    turn_rad: Tail  # absolute yaw of θ
    inside: Share  # detections within `PAPER_XY_M` in any direction and `PAPER_YAW_RAD`
    inside_by_any: Share  # detections of which any reading is, not only the most probable one


@dataclass(frozen=True, slots=True, kw_only=True)
class PoseSummary:
    """One estimator's figures."""

    overall: PoseGroup  # all images that show the robot
    target: PoseGroup  # those of them for which there is a goal
    by: dict[str, dict[str, PoseGroup]]  # groups by distance, visibility, heading, kind and renderer
    false_detections: Share  # images with a pose, of those in which nothing of the robot is visible
    false_covered: Share  # the same of copies in which its surroundings cover the robot
    # coverage, window: of all detections; None without any.
    coverage: Coverage | None
    window: WindowUse | None
    # duration_median_s, duration_p95_s: per image.
    duration_median_s: float
    duration_p95_s: float

    @property
    def reached(self) -> bool:
        """Whether the estimator meets the goal."""
        goal = self.target
        if goal.position_m is None or goal.heading_rad is None:
            return False
        return (
            goal.position_m.median <= TARGET_POSITION_M
            and goal.heading_rad.median <= TARGET_HEADING_RAD
            and goal.detected.interval.value >= TARGET_DETECTION
        )


def pose_summary(images: pd.DataFrame) -> PoseSummary:
    """All figures of one estimator, from a table of `pose_table`."""
    shown, detected = grouped(images[images.shows_robot]), images[images.detected]
    return PoseSummary(
        overall=_group(shown),
        target=_group(shown[has_goal(shown)]),
        by={
            name: {str(label): _group(rows) for label, rows in shown.groupby(column, observed=False)}
            for name, column in GROUPS.items()
        },
        false_detections=Share.true(images.found[~images.shows_robot]),
        false_covered=Share.true(images.found_covered),
        coverage=_coverage(detected) if len(detected) else None,
        window=_window_use(detected),
        duration_median_s=float(images.duration_s.median()),
        duration_p95_s=float(images.duration_s.quantile(0.95)),
    )


def has_goal(images: pd.DataFrame) -> pd.Series:
    """Which images there is a goal for: plausible ones of a near and clearly visible robot."""
    near, clear = images.distance_m < TARGET_DISTANCE_M, images.visibility > TARGET_VISIBILITY
    return (images.kind == "plausible") & images.shows_robot & near & clear


GROUPS = {
    "distance": "distances",
    "visibility": "visibilities",
    "heading": "headings",
    "kind": "kind",
    "renderer": "renderer",
}
"""Names of the groupings of images that show the robot, and their columns in a table of `grouped`."""


def grouped(shown: pd.DataFrame) -> pd.DataFrame:
    """The table of images that show the robot, with the columns of `GROUPS`."""
    sectors = np.round(shown.heading_rad / (math.pi / 4.0)).astype(int) % len(HEADINGS)
    return shown.assign(
        distances=_binned(shown.distance_m, (1.0, 1.75, 2.5, 3.5), DISTANCES),
        visibilities=_binned(shown.visibility, (0.25, 0.5, 0.75), VISIBILITIES),
        headings=pd.Categorical.from_codes(sectors, HEADINGS, ordered=True),
    )


def _binned(values: pd.Series, edges: tuple[float, ...], labels: tuple[str, ...]) -> pd.Series:
    return pd.cut(values, [-math.inf, *edges, math.inf], right=False, labels=labels)


def _group(images: pd.DataFrame) -> PoseGroup:
    made = images[images.detected]
    median = made[["dx_m", "dy_m", "dyaw_rad"]].abs().median()
    return PoseGroup(
        detected=Share.true(images.detected),
        median=tuple(median) if len(made) else None,
        position_m=Tail.of(made.position_m),
        heading_rad=Tail.of(made.turn_rad),
        confused=Share.true(made.confused),
        told_otherwise=Share.true(made.told_otherwise[made.confused]),
    )


def _coverage(detected: pd.DataFrame) -> Coverage:
    mean = float(detected.nees.mean())
    return Coverage(
        inside=tuple(Share.true(detected.ellipsoid <= level) for level in LEVELS),
        nees_median=float(detected.nees.median()),
        nees_mean=mean if math.isfinite(mean) else None,
    )


def _window_use(detected: pd.DataFrame) -> WindowUse | None:
    offset_m, turn_rad = Tail.of(detected.offset_m), Tail.of(detected.yaw_off_rad)
    if offset_m is None or turn_rad is None:
        return None
    inside, by_any = Share.true(detected.inside), Share.true(detected.inside_by_any)
    return WindowUse(offset_m=offset_m, turn_rad=turn_rad, inside=inside, inside_by_any=by_any)
