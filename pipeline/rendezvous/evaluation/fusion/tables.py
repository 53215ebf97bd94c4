"""Tables of the report on the whole system."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence

from rendezvous.evaluation.frame_error.summary import OVERLAP_BINS
from rendezvous.evaluation.fusion.gallery import TITLES, error_words, is_good
from rendezvous.evaluation.fusion.runs import SOURCES, FusionOutcome, RendezvousOutcome
from rendezvous.evaluation.fusion.summary import FusionFigures, FusionGroup
from rendezvous.evaluation.relative_pose.tables import share_cell
from rendezvous.evaluation.report.html_page import Cell, Html, badge, joined, table
from rendezvous.evaluation.report.recorded_figures import RecordedFigures

_DASH = "–"
_SOURCE_TITLES = {"estimated": "Estimated relative pose", "true": "True relative pose"}
Rows = Mapping[str, RecordedFigures[FusionFigures]]
Lines = list[list[Cell | None]]


def fusion_table(rows: Rows, measured: Sequence[str]) -> Html:
    """Successes, errors and agreement by run."""
    words = ("success", "fused", "median Δx m", "Δy m", "Δψ °", "position m", "95 % below")
    more = ("agreement, mean", "median", "maps told", "median ms")
    body = _by_source(
        rows,
        measured,
        lambda figures: [
            share_cell(figures.overall.success),
            share_cell(figures.overall.made),
            *_errors(figures.overall),
            *_agreement(figures.overall),
            share_cell(figures.refined),
            Cell(main=_number(figures.duration_median_s, 0, scale=1000.0)),
        ],
    )
    return table([[(word, 1) for word in ("", *words, *more)]], body)


def overlap_table(rows: Rows, measured: Sequence[str]) -> Html:
    """Success and median errors by bins of overlap."""
    header = [
        [("overlap", 1), *((label, 3) for label in OVERLAP_BINS)],
        [("", 1), *((word, 1) for _ in OVERLAP_BINS for word in ("success", "m", "°"))],
    ]
    body = _by_source(
        rows,
        measured,
        lambda figures: [cell for label in OVERLAP_BINS for cell in _bin(figures.by_overlap.get(label))],
    )
    return table(header, body)


def verdict_table(rows: Rows, measured: Sequence[str]) -> Html:
    """What is accepted, and what is wrong of it."""
    words = ("accepted", "wrong of the accepted", "wrong of the uncertain")
    body = _by_source(
        rows,
        measured,
        lambda figures: [
            share_cell(figures.accepted),
            share_cell(figures.wrong_accepted),
            share_cell(figures.wrong_uncertain),
        ],
    )
    return table([[(word, 1) for word in ("", *words)]], body)


def scenario_table(outcome: RendezvousOutcome) -> Html:
    """Every run of one rendezvous."""
    words = ("", "", "error of T̂", "map agreement", "verdict")
    body: Lines = []
    for (source, method), found in outcome.runs.items():
        body.append(
            [
                Cell(main=_SOURCE_TITLES[source], kind="name"),
                Cell(main=TITLES[method], kind="name"),
                Cell(main=error_words(found), best=is_good(found)),
                Cell(main=_number(found.iou, 3)),
                Cell(main=_verdict(found), kind="words"),
            ]
        )
    return table([[(word, 1) for word in words]], body)


def _by_source(rows: Rows, measured: Sequence[str], cells: Callable[[FusionFigures], list[Cell]]) -> Lines:
    """A line for each run, the runs of each source under its name."""
    body: Lines = []
    for source in SOURCES:
        runs = {name: row for name, row in rows.items() if name.startswith(f"{source}-")}
        if not runs:
            continue
        body.append([None])
        for name, row in runs.items():
            body.append([_run(source, name, row, measured), *cells(row.figures)])
    return body


def _run(source: str, name: str, row: RecordedFigures[FusionFigures], measured: Sequence[str]) -> Cell:
    c = row.conditions
    method = name.removeprefix(f"{source}-")
    where = badge("measured", "measured") if name in measured else badge("recorded", "recorded")
    told = "" if name in measured else f"; {c.images:,} of {c.split}, commit {c.commit[:7] or 'not known'}"
    main = joined(TITLES[method], " ", where)
    return Cell(main=main, small=f"{_SOURCE_TITLES[source]}{told}", kind="name source")


def _verdict(found: FusionOutcome) -> str:
    return "accepted" if found.accepted else f"uncertain: {'; '.join(found.reasons)}"


def _bin(group: FusionGroup | None) -> list[Cell]:
    if group is None:
        return [Cell(main=_DASH)] * 3
    position_m = None if group.position_m is None else group.position_m.median
    heading_rad = None if group.heading_rad is None else group.heading_rad.median
    return [
        share_cell(group.success),
        Cell(main=_number(position_m, 3)),
        Cell(main=_number(heading_rad, 2, scale=180.0 / math.pi)),
    ]


def _errors(group: FusionGroup) -> list[Cell]:
    if group.median is None or group.position_m is None or group.heading_rad is None:
        return [Cell(main=_DASH)] * 5
    x_m, y_m, yaw_rad = group.median
    return [
        Cell(main=f"{x_m:.3f}"),
        Cell(main=f"{y_m:.3f}"),
        Cell(main=f"{math.degrees(yaw_rad):.2f}"),
        Cell(main=f"{group.position_m.median:.3f}"),
        Cell(main=f"{group.position_m.p95:.2f} m", small=f"{math.degrees(group.heading_rad.p95):.1f}°"),
    ]


def _agreement(group: FusionGroup) -> list[Cell]:
    return [Cell(main=_number(group.iou_mean, 3)), Cell(main=_number(group.iou_median, 3))]


def _number(value: float | None, decimals: int, *, scale: float = 1.0) -> str:
    return _DASH if value is None else f"{scale * value:.{decimals}f}"
