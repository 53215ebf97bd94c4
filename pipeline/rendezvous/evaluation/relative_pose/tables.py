"""Tables of the report on the relative pose."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from rendezvous.evaluation.frame_error.calibration import LEVELS
from rendezvous.evaluation.relative_pose.errors import PoseOutcomes
from rendezvous.evaluation.relative_pose.summary import PoseGroup, PoseSummary, Share, Tail
from rendezvous.evaluation.report.html_page import Cell, Html, badge, joined, table
from rendezvous.evaluation.report.recorded_figures import RecordedFigures

_DASH = "–"
_EXTREMES = 5
Rows = Mapping[str, RecordedFigures[PoseSummary]]

VARIANTS = {"floor": "Floor known", "free": "6 degrees of freedom"}
"""What an estimator may take as known, in the order of tables."""


def variant_title(name: str) -> str:
    """A variant as tables call it."""
    return VARIANTS[name]


def share_words(share: Share) -> str:
    """A share in percent."""
    return f"{100.0 * share.interval.value:.1f} %" if share.of else _DASH


def headline_table(rows: Rows, measured: Sequence[str]) -> Html:
    """The images for which there is a goal, then all, by variant."""
    words = (
        "found",
        "median Δx m",
        "Δy m",
        "Δψ °",
        "position m",
        "heading °",
        "95 % below",
        "found",
        "position m",
        "heading °",
        "95 % below",
        "without it",
        "with it covered",
    )
    header = [
        [
            ("", 1),
            ("images for which there is a goal", 7),
            ("all that show the robot", 4),
            ("false detections", 2),
        ],
        [("", 1), *((word, 1) for word in words)],
    ]
    body: list[list[Cell | None]] = [
        [
            variant_cell(name, row, measured),
            _found(row.figures.target),
            *_medians(row.figures.target),
            *_tails(row.figures.target),
            _found(row.figures.overall),
            *_tails(row.figures.overall),
            share_cell(row.figures.false_detections),
            share_cell(row.figures.false_covered),
        ]
        for name, row in rows.items()
    ]
    return table(header, body)


def group_table(name: str, groups: Mapping[str, PoseGroup]) -> Html:
    """Detections and errors by group."""
    words = (name, "images", "found", "median Δx m", "Δy m", "Δψ °", "position m", "heading °", "95 % below")
    header = [[(word, 1) for word in (*words, "front for back")]]
    body: list[list[Cell | None]] = [
        [
            Cell(main=label, kind="name"),
            Cell(main=f"{group.detected.of:,}"),
            _found(group),
            *_medians(group),
            *_tails(group),
            share_cell(group.confused),
        ]
        for label, group in groups.items()
    ]
    return table(header, body)


def extremes_table(outcomes: PoseOutcomes) -> Html:
    """The detections with the largest errors in position, then in heading."""
    words = ("image", "largest in", "position m", "heading °", "distance m", "visible", "kind", "score")
    body: list[list[Cell | None]] = []
    for component, errors in (("position", outcomes.position_m), ("heading", outcomes.heading_rad)):
        order = np.argsort(-np.nan_to_num(errors, nan=-1.0), kind="stable")[:_EXTREMES]
        for number in order[outcomes.detected[order]]:
            truth, row = outcomes.truths[number], outcomes.rows[number]
            body.append(
                [
                    Cell(main=truth.image_id, kind="name source"),
                    Cell(main=component),
                    Cell(main=f"{outcomes.position_m[number]:.2f}"),
                    Cell(main=f"{math.degrees(outcomes.heading_rad[number]):.1f}"),
                    Cell(main=f"{truth.distance_m:.2f}"),
                    Cell(main=f"{100.0 * truth.visibility:.0f} %"),
                    Cell(main=truth.kind),
                    Cell(main=f"{row.score:.2f}"),
                ]
            )
        if component == "position":
            body.append([None])
    return table([[(word, 1) for word in words]], body)


def coverage_table(rows: Rows, measured: Sequence[str]) -> Html:
    """Errors inside the ellipsoids, by variant."""
    header = [
        [("", 1), ("errors inside the ellipsoid of", 3), ("NEES (right: mean 3)", 2)],
        [("", 1), *((f"{100 * level:.0f} %", 1) for level in LEVELS), ("median", 1), ("mean", 1)],
    ]
    body: list[list[Cell | None]] = []
    for name, row in rows.items():
        if (found := row.figures.coverage) is not None:
            mean = "∞" if found.nees_mean is None else f"{found.nees_mean:.2f}"
            shares = [share_cell(share) for share in found.inside]
            medians = [Cell(main=f"{found.nees_median:.2f}"), Cell(main=mean)]
            body.append([variant_cell(name, row, measured), *shares, *medians])
    return table(header, body)


def window_table(rows: Rows, measured: Sequence[str]) -> Html:
    """The frame error that the relative pose leaves, by variant."""
    quantiles = ("median", "95 % below", "99 % below", "largest")
    header = [
        [("", 1), ("distance of θ_w, m", 4), ("turn of θ_w, °", 4), ("in the window", 2)],
        [("", 1), *((word, 1) for word in (*quantiles, *quantiles, "best reading", "any reading"))],
    ]
    body: list[list[Cell | None]] = []
    for name, row in rows.items():
        if (window := row.figures.window) is not None:
            offset = [Cell(main=f"{value:.2f}") for value in _quantiles(window.offset_m)]
            turn = [Cell(main=f"{math.degrees(value):.1f}") for value in _quantiles(window.turn_rad)]
            inside = [share_cell(window.inside), share_cell(window.inside_by_any)]
            body.append([variant_cell(name, row, measured), *offset, *turn, *inside])
    return table(header, body)


def time_table(rows: Rows, measured: Sequence[str]) -> Html:
    """Time per image."""
    body: list[list[Cell | None]] = [
        [
            variant_cell(name, row, measured),
            Cell(main=f"{1000.0 * row.figures.duration_median_s:.0f}"),
            Cell(main=f"{1000.0 * row.figures.duration_p95_s:.0f}"),
            Cell(main=f"one thread, {row.conditions.hardware}", kind="words"),
        ]
        for name, row in rows.items()
    ]
    return table([[(w, 1) for w in ("", "median ms", "95 % below ms", "")]], body)


def variant_cell(name: str, row: RecordedFigures[PoseSummary], measured: Sequence[str]) -> Cell:
    """The variant, and where its figures are from."""
    c = row.conditions
    if name in measured:
        return Cell(main=joined(variant_title(name), " ", badge("measured", "measured")), kind="name source")
    return Cell(
        main=joined(variant_title(name), " ", badge("recorded", "recorded")),
        small=f"{c.images:,} images of {c.split}, commit {c.commit[:7] or 'not known'}",
        kind="name source",
    )


def _found(group: PoseGroup) -> Cell:
    return share_cell(group.detected)


def share_cell(share: Share) -> Cell:
    """A share in percent, and its interval below."""
    if not share.of:
        return Cell(main=_DASH)
    interval = share.interval
    return Cell(main=share_words(share), small=f"{100.0 * interval.low:.1f} … {100.0 * interval.high:.1f}")


def _medians(group: PoseGroup) -> list[Cell]:
    if group.median is None:
        return [Cell(main=_DASH)] * 3
    x_m, y_m, yaw_rad = group.median
    return [Cell(main=f"{x_m:.3f}"), Cell(main=f"{y_m:.3f}"), Cell(main=f"{math.degrees(yaw_rad):.1f}")]


def _tails(group: PoseGroup) -> list[Cell]:
    """Medians of position and heading, and below what 95 % lie."""
    if group.position_m is None or group.heading_rad is None:
        return [Cell(main=_DASH)] * 3
    return [
        Cell(main=f"{group.position_m.median:.3f}"),
        Cell(main=f"{math.degrees(group.heading_rad.median):.1f}"),
        Cell(main=f"{group.position_m.p95:.2f} m", small=f"{math.degrees(group.heading_rad.p95):.1f}°"),
    ]


def _quantiles(tail: Tail) -> tuple[float, float, float, float]:
    return tail.median, tail.p95, tail.p99, tail.largest
