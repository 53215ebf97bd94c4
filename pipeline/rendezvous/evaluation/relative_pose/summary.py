"""What an estimator's poses come to: errors and detections in total, by distance, visibility and heading."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from rendezvous.alignment.spread import ellipsoid_probability, nees
from rendezvous.alignment.window import PAPER_XY_M, PAPER_YAW_RAD
from rendezvous.evaluation.frame_error.calibration import LEVELS
from rendezvous.evaluation.relative_pose.errors import PoseOutcomes
from rendezvous.evaluation.statistics import Interval, wilson_interval
from rendezvous.geometry.occupancy_grid import Mask
from rendezvous.geometry.se2 import Array

TARGET_VISIBILITY, TARGET_DISTANCE_M = 0.5, 2.5
TARGET_POSITION_M, TARGET_HEADING_RAD, TARGET_DETECTION = 0.05, math.radians(3.0), 0.95
"""Wanted of images that show more than half of a near robot: medians at most, detections at least."""

WINDOW_XY_M, WINDOW_YAW_RAD = PAPER_XY_M, PAPER_YAW_RAD
"""Frame errors for which estimators are trained and measured (the paper's range, as far as one can tell)."""

DISTANCES = ("< 1 m", "1–1.75 m", "1.75–2.5 m", "2.5–3.5 m", "> 3.5 m")
VISIBILITIES = ("< 0.25", "0.25–0.5", "0.5–0.75", "> 0.75")
HEADINGS = (
    "away",
    "away, left",
    "left",
    "towards, left",
    "towards",
    "towards, right",
    "right",
    "away, right",
)
"""Sectors of 45°, the first one centred on a robot that drives away."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Share:
    """So many of so many."""

    count: int
    of: int

    @staticmethod
    def within(chosen: Mask, among: Mask) -> Share:
        """Of (N,) images among some, those that are chosen."""
        return Share(count=int((chosen & among).sum()), of=int(among.sum()))

    @property
    def interval(self) -> Interval:
        """The share with Wilson's interval; NaN of nothing."""
        return wilson_interval(self.count, self.of)


@dataclass(frozen=True, slots=True, kw_only=True)
class Tail:
    """Quantiles of absolute errors, and the largest."""

    median: float
    p95: float
    p99: float
    largest: float

    @staticmethod
    def of(values: Array) -> Tail:
        """Of at least one value (N,)."""
        median, p95, p99, largest = (float(q) for q in np.quantile(values, (0.5, 0.95, 0.99, 1.0)))
        return Tail(median=median, p95=p95, p99=p99, largest=largest)


@dataclass(frozen=True, slots=True, kw_only=True)
class PoseGroup:
    """Some images that show the robot.

    Attributes:
        detected: those in which it was found.
        median: absolute Δx [m], Δy [m], Δψ [rad] of the detections; None without one, as the next two.
        position_m: distance of Δx and Δy.
        heading_rad: absolute Δψ.
        confused: detections whose heading is wrong by more than a right angle.
        told_otherwise: of those, the ones of which another reading has it right.
    """

    detected: Share
    median: tuple[float, float, float] | None
    position_m: Tail | None
    heading_rad: Tail | None
    confused: Share
    told_otherwise: Share


@dataclass(frozen=True, slots=True, kw_only=True)
class Coverage:
    """How well covariances tell the errors of detections.

    Attributes:
        inside: by `calibration.LEVELS`, errors inside the ellipsoid of that probability.
        nees_median, nees_mean: the mean is 3 if covariances are right, and None if one is singular; the
            median is 2.37 then of normal errors, and less of heavy tails.
    """

    inside: tuple[Share, ...]
    nees_median: float
    nees_mean: float | None


@dataclass(frozen=True, slots=True, kw_only=True)
class WindowUse:
    """The frame error that T̃ has by the relative pose, against the window of frame-error estimators.

    Attributes:
        offset_m: distance of θ_w's x and y.
        turn_rad: its absolute yaw.
        inside: detections within `WINDOW_XY_M` in any direction and `WINDOW_YAW_RAD`.
        inside_by_any: detections of which any reading is, not only the most probable one.
    """

    offset_m: Tail
    turn_rad: Tail
    inside: Share
    inside_by_any: Share


@dataclass(frozen=True, slots=True, kw_only=True)
class PoseSummary:
    """One estimator's figures.

    Attributes:
        overall: all images that show the robot.
        target: the plausible ones of those for which a goal was set.
        by: groups by name, of `distance`, `visibility`, `heading`, `kind`.
        false_detections: of images in which nothing of the robot is to be seen, those with a pose.
        false_covered: the same of copies in which the robot is covered by what is beside it.
        coverage, window: of all detections; None without one.
        duration_median_s, duration_p95_s: per image.
    """

    overall: PoseGroup
    target: PoseGroup
    by: dict[str, dict[str, PoseGroup]]
    false_detections: Share
    false_covered: Share
    coverage: Coverage | None
    window: WindowUse | None
    duration_median_s: float
    duration_p95_s: float

    @property
    def reached(self) -> bool:
        """Whether the goal is met."""
        goal = self.target
        if goal.position_m is None or goal.heading_rad is None:
            return False
        return (
            goal.position_m.median <= TARGET_POSITION_M
            and goal.heading_rad.median <= TARGET_HEADING_RAD
            and goal.detected.interval.value >= TARGET_DETECTION
        )


def pose_summary(found: PoseOutcomes) -> PoseSummary:
    """All figures of one estimator."""
    return PoseSummary(
        overall=pose_group(found, found.shows_robot),
        target=pose_group(found, target_images(found)),
        by={
            name: {label: pose_group(found, mask) for label, mask in groups.items()}
            for name, groups in groupings(found).items()
        },
        false_detections=Share.within(found.found, ~found.shows_robot),
        false_covered=Share.within(found.found_covered, found.covered),
        coverage=_coverage(found) if found.detected.any() else None,
        window=_window_use(found) if found.detected.any() else None,
        duration_median_s=float(np.median(found.duration_s)),
        duration_p95_s=float(np.quantile(found.duration_s, 0.95)),
    )


def target_images(found: PoseOutcomes) -> Mask:
    """(N,) the images for which a goal was set."""
    near = found.truth("distance_m") < TARGET_DISTANCE_M
    clear = found.truth("visibility") > TARGET_VISIBILITY
    return found.of_kind("plausible") & found.shows_robot & near & clear


def groupings(found: PoseOutcomes) -> dict[str, dict[str, Mask]]:
    """Images that show the robot, by what may matter: (N,) masks by the group's name."""
    shown = found.shows_robot
    heading = np.nan_to_num(found.truth("heading_rad"))
    sector = np.round(heading / (math.pi / 4.0)).astype(int) % len(HEADINGS)
    distance = np.digitize(np.nan_to_num(found.truth("distance_m")), (1.0, 1.75, 2.5, 3.5))
    visibility = np.digitize(found.truth("visibility"), (0.25, 0.5, 0.75))
    kinds = sorted({truth.kind for truth in found.truths})
    return {
        "distance": {label: shown & (distance == i) for i, label in enumerate(DISTANCES)},
        "visibility": {label: shown & (visibility == i) for i, label in enumerate(VISIBILITIES)},
        "heading": {label: shown & (sector == i) for i, label in enumerate(HEADINGS)},
        "kind": {kind: shown & found.of_kind(kind) for kind in kinds},
    }


def pose_group(found: PoseOutcomes, chosen: Mask) -> PoseGroup:
    """Figures of the chosen (N,) images."""
    made = chosen & found.detected
    confused = found.confused & made
    median = np.median(np.abs(found.error[made]), axis=0) if made.any() else None
    return PoseGroup(
        detected=Share.within(found.detected, chosen),
        median=None if median is None else (float(median[0]), float(median[1]), float(median[2])),
        position_m=Tail.of(found.position_m[made]) if made.any() else None,
        heading_rad=Tail.of(found.heading_rad[made]) if made.any() else None,
        confused=Share.within(found.confused, made),
        told_otherwise=Share.within(found.told_otherwise, confused),
    )


def ellipsoids(found: PoseOutcomes) -> Array:
    """(D,) of each detection, the probability of the smallest ellipsoid that holds its error."""
    distance = nees(found.error[found.detected], found.covariance[found.detected])
    return ellipsoid_probability(distance, found.degrees_of_freedom[found.detected])


def _coverage(found: PoseOutcomes) -> Coverage:
    distance = nees(found.error[found.detected], found.covariance[found.detected])
    probability, mean = ellipsoids(found), float(distance.mean())
    return Coverage(
        inside=tuple(Share(count=int((probability <= level).sum()), of=len(probability)) for level in LEVELS),
        nees_median=float(np.median(distance)),
        nees_mean=mean if math.isfinite(mean) else None,
    )


def _window_use(found: PoseOutcomes) -> WindowUse:
    theta = found.theta[found.detected]
    inside = _in_window(theta)
    by_any = [_in_window(found.thetas(int(number))).any() for number in np.flatnonzero(found.detected)]
    return WindowUse(
        offset_m=Tail.of(np.hypot(theta[:, 0], theta[:, 1])),
        turn_rad=Tail.of(np.abs(theta[:, 2])),
        inside=Share(count=int(inside.sum()), of=len(inside)),
        inside_by_any=Share(count=sum(map(bool, by_any)), of=len(by_any)),
    )


def _in_window(theta: Array) -> Mask:
    """(N,) which frame errors (N, 3) lie in the window, however it is turned."""
    inside: Mask = (np.hypot(theta[:, 0], theta[:, 1]) <= WINDOW_XY_M) & (
        np.abs(theta[:, 2]) <= WINDOW_YAW_RAD
    )
    return inside
