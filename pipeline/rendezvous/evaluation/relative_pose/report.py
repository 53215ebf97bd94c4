"""The part of the report on the relative pose: Fig. 5 of the paper."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from rendezvous.evaluation.relative_pose.errors import PoseOutcomes
from rendezvous.evaluation.relative_pose.gallery import PoseShown, pose_gallery
from rendezvous.evaluation.relative_pose.summary import (
    TARGET_DETECTION,
    TARGET_DISTANCE_M,
    TARGET_HEADING_RAD,
    TARGET_POSITION_M,
    TARGET_VISIBILITY,
    WINDOW_XY_M,
    WINDOW_YAW_RAD,
    PoseSummary,
    groupings,
)
from rendezvous.evaluation.relative_pose.tables import (
    coverage_table,
    extremes_table,
    group_table,
    headline_table,
    share_words,
    time_table,
    variant_title,
    window_table,
)
from rendezvous.evaluation.relative_pose.violins import Component, violin_chart
from rendezvous.evaluation.report.html_page import Html, figure, joined, old_part, paragraph, strong
from rendezvous.evaluation.report.origin import origin_table
from rendezvous.evaluation.report.page import ReportPart
from rendezvous.evaluation.report.recorded_figures import ImageConditions, RecordedFigures
from rendezvous.evaluation.statistics import Interval
from rendezvous.geometry.se2 import Array

KEY = "relative_pose"

COMPONENTS = (
    Component(name="Δx", unit="m"),
    Component(name="Δy", unit="m"),
    Component(name="Δψ", unit="°"),
)
_HEADINGS = {"distance": "By distance", "visibility": "By visibility", "heading": "By heading, as seen"}

Rows = Mapping[str, RecordedFigures[PoseSummary]]


@dataclass(frozen=True, slots=True, kw_only=True)
class FloorGain:
    """Differences of mean errors on images in which both variants found the robot: floor minus free.

    Attributes:
        images: how many.
        position_m, heading_rad: negative where the floor helps.
    """

    images: int
    position_m: Interval
    heading_rad: Interval


@dataclass(frozen=True, slots=True, kw_only=True)
class PoseContent:
    """All that the part tells.

    Attributes:
        conditions: of what was measured now.
        found: outcomes by variant, measured now; the first is the one that is shown in detail.
        rows: figures by variant, measured now or recorded.
        gain: what the floor changes; None unless both variants were measured now.
        gallery: images that are drawn.
        dataset: its folder.
        versions: of packages.
    """

    conditions: ImageConditions
    found: Mapping[str, PoseOutcomes]
    rows: Rows
    gain: FloorGain | None
    gallery: Sequence[PoseShown]
    dataset: str
    versions: Mapping[str, str]

    @property
    def main(self) -> str:
        """The variant that is shown in detail."""
        return next(iter(self.found))


def pose_part(content: PoseContent) -> ReportPart:
    """The part; sections that have nothing to tell are left out."""
    outcomes, summary = content.found[content.main], content.rows[content.main].figures
    sections = [
        ("headline", "What was wanted, and what was reached", _headline(content)),
        ("errors", "Errors in total (the paper's Fig. 5)", _in_total(content)),
        *((name, words, _by(name, outcomes, summary)) for name, words in _HEADINGS.items()),
        ("extremes", "Extremes", _extremes(outcomes, summary)),
        ("calibration", "Does it know its error?", _calibration(content)),
        ("window", "What is left to the maps", _window(content)),
        ("gallery", "Images", pose_gallery(content.gallery)),
        ("time", "Time", [time_table(content.rows, list(content.found))]),
        ("origin", "How it was made", [_origin(content)]),
    ]
    return old_part(
        key=KEY,
        title="Relative pose: where one image puts the other robot",
        lead=_lead(content.main, summary),
        shown_facts=_facts(content.conditions, content.found[content.main]),
        sections=tuple((anchor, heading, joined(*pieces)) for anchor, heading, pieces in sections if pieces),
    )


def _lead(variant: str, summary: PoseSummary) -> Html:
    goal = summary.target
    if goal.position_m is None or goal.heading_rad is None:
        return paragraph(
            "No plausible image of a near, clearly visible robot was measured, or it was found in none.",
            kind="lead",
        )
    return paragraph(
        strong(
            f"Median error {goal.position_m.median:.3f} m and {math.degrees(goal.heading_rad.median):.1f}°"
        ),
        f", found in {share_words(goal.detected)} of the plausible images that show more than half of a "
        f"robot nearer than {TARGET_DISTANCE_M:g} m ({variant_title(variant)}). Wanted: "
        f"{TARGET_POSITION_M:g} m, {math.degrees(TARGET_HEADING_RAD):g}°, {100 * TARGET_DETECTION:g} %: "
        f"{'reached' if summary.reached else 'not reached'}.",
        kind="lead",
    )


def _facts(c: ImageConditions, found: PoseOutcomes) -> tuple[tuple[str, str], ...]:
    kinds = {truth.kind for truth in found.truths}
    known = c.trained_on.get("relative pose")
    return (
        ("split", c.split),
        *((f"{kind} images", f"{int(found.of_kind(kind).sum()):,}") for kind in sorted(kinds)),
        ("without the robot", f"{int((~found.shows_robot).sum()):,}"),
        ("floor plans", f"{c.plans:,}"),
        ("of them trained on", "not known" if known is None else f"{known:,}"),
        ("data", c.data_digest[:12]),
        ("seed", str(c.seed)),
    )


def _headline(content: PoseContent) -> list[Html]:
    pieces = [
        paragraph(
            "An image and where its camera sits on robot 0 are given; wanted is the pose of robot 1 as seen "
            "by robot 0 on the floor. The error is the components of T̂⁻¹ T. “Floor known”: both robots "
            "stand on one floor, so that only x, y and yaw are free. “6 degrees of freedom” is the paper's "
            "way."
        ),
        headline_table(content.rows, list(content.found)),
        paragraph(
            f"Wanted of plausible images, visibility above {TARGET_VISIBILITY:g}, nearer than "
            f"{TARGET_DISTANCE_M:g} m. False detections are of images in which nothing of the robot is to be "
            "seen, and of all others once the robot is covered by what is beside it. Intervals of shares are "
            "Wilson's, which takes images as independent.",
            kind="note",
        ),
    ]
    if content.gain is not None:
        pieces.append(_gain(content.gain))
    return pieces


def _gain(gain: FloorGain) -> Html:
    def told(value: Interval, unit: str) -> str:
        numbers = f"{value.value:+.3f}{unit} ({value.low:+.3f} … {value.high:+.3f})"
        return numbers.replace("-", "−")

    return paragraph(
        strong("What the floor gains: "),
        f"on {gain.images:,} images in which both found the robot, the floor changes the mean error by "
        f"{told(gain.position_m, ' m')} in position and {told(gain.heading_rad.scaled(180 / math.pi), '°')} "
        "in heading (negative: it helps; paired 95 % bootstrap intervals over floor plans).",
    )


def degrees(errors: Array) -> Array:
    """Errors (N, 3) with the heading in degrees."""
    return errors * (1.0, 1.0, 180.0 / math.pi)


def _in_total(content: PoseContent) -> list[Html]:
    groups = {
        variant_title(name): degrees(outcomes.error[outcomes.shows_robot])
        for name, outcomes in content.found.items()
    }
    return [
        figure(
            violin_chart(groups, COMPONENTS),
            "Errors of all images that show the robot: density, median, quartiles, whiskers at 1.5 times the "
            "quartiles' distance. x is ahead of robot 1 and y to its left, as the estimate has it stand. "
            "“Of” counts the images in which the robot is not found as well.",
            alt="Errors in total",
        )
    ]


def _by(name: str, outcomes: PoseOutcomes, summary: PoseSummary) -> list[Html]:
    masks = groupings(outcomes)[name]
    groups = {label: degrees(outcomes.error[mask]) for label, mask in masks.items() if mask.any()}
    if not groups:
        return []
    notes = {
        "heading": "Which way robot 1 faces, from the line of sight: “towards” looks at the camera.",
        "visibility": "Visible pixels of all pixels of the silhouette.",
    }
    return [
        figure(violin_chart(groups, COMPONENTS), notes.get(name, ""), alt=f"Errors by {name}"),
        group_table(name, summary.by[name]),
    ]


def _extremes(outcomes: PoseOutcomes, summary: PoseSummary) -> list[Html]:
    if summary.overall.position_m is None or summary.overall.heading_rad is None:
        return []
    confused, told = summary.overall.confused, summary.overall.told_otherwise
    return [
        paragraph(
            f"99 % of the errors are below {summary.overall.position_m.p99:.2f} m and "
            f"{math.degrees(summary.overall.heading_rad.p99):.1f}°. Front and back are confused (heading off "
            f"by more than 90°) in {confused.count:,} of {confused.of:,} detections; in {told.count:,} of "
            "these another reading that the estimator gives has the heading right."
        ),
        extremes_table(outcomes),
    ]


def _calibration(content: PoseContent) -> list[Html]:
    if not any(row.figures.coverage for row in content.rows.values()):
        return []
    return [
        paragraph(
            "Of the errors, 50, 90 and 95 % should lie inside the covariance's ellipsoids of those "
            "probabilities. Confused headings are counted as they are, outside."
        ),
        coverage_table(content.rows, list(content.found)),
    ]


def _window(content: PoseContent) -> list[Html]:
    summary = content.rows[content.main].figures
    if summary.window is None:
        return []
    window = summary.window
    return [
        paragraph(
            "T̃ puts map 1 wrong by the error of the relative pose. Seen at the meeting point that is θ_w, "
            f"which frame-error estimators are trained and measured for up to ±{WINDOW_XY_M:g} m and "
            f"±{math.degrees(WINDOW_YAW_RAD):g}°. A search of ±{window.offset_m.p99:.2f} m and "
            f"±{math.degrees(window.turn_rad.p99):.1f}° would do for 99 % of the detections in each of the "
            f"two: {window.offset_m.p99 / WINDOW_XY_M:.0%} and {window.turn_rad.p99 / WINDOW_YAW_RAD:.0%} of "
            "that window."
        ),
        window_table(content.rows, list(content.found)),
        paragraph(
            "The distance is θ_w's in x and y together, so that it fits whatever the window's heading; the "
            "SLAM poses, which T̃ rests on as well, are taken as exact.",
            kind="note",
        ),
    ]


def _origin(content: PoseContent) -> Html:
    c = content.conditions
    return origin_table(
        [
            ("dataset", f"{content.dataset}, split {c.split}"),
            ("digest of the images", c.data_digest),
            *((f"weights, {name}", digest) for name, digest in c.weights.items()),
            ("commit", c.commit or "not known"),
            ("hardware", c.hardware),
            *content.versions.items(),
        ]
    )
