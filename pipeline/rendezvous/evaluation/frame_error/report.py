"""The part of the report on frame-error estimators."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from rendezvous.alignment.estimate import WRONG_M, WRONG_RAD
from rendezvous.evaluation.frame_error.charts import calibration_chart, cdf_chart, curve_chart, scatter_chart
from rendezvous.evaluation.frame_error.estimates import SUCCESS_M, SUCCESS_RAD, Outcomes, Pairs
from rendezvous.evaluation.frame_error.gallery import Panel
from rendezvous.evaluation.frame_error.measured_row import Conditions, MeasuredRow
from rendezvous.evaluation.frame_error.notes import OVERLAP, SHARES, TASK, comparison_note, table_one_note
from rendezvous.evaluation.frame_error.report_gallery import Shown, attention_section, gallery_section
from rendezvous.evaluation.frame_error.report_symmetry import symmetry_section
from rendezvous.evaluation.frame_error.summary import Comparison, ranking
from rendezvous.evaluation.frame_error.symmetry import Symmetry
from rendezvous.evaluation.frame_error.table_one import title
from rendezvous.evaluation.frame_error.tables import (
    calibration_table,
    comparison_table,
    overlap_table,
    share_words,
    table_one,
    time_table,
)
from rendezvous.evaluation.report.html_page import (
    Html,
    Piece,
    figure,
    joined,
    paragraph,
    strong,
)
from rendezvous.evaluation.report.origin import origin_table
from rendezvous.evaluation.report.page import ReportPart, ReportSection

KEY = "frame_error"


@dataclass(frozen=True, slots=True, kw_only=True)
class FrameErrorContent:
    """All that the part tells.

    Attributes:
        conditions: of what was measured now.
        found: outcomes by method, measured now.
        rows: figures by method, measured now or recorded, in the order of tables.
        pairs: what was measured on.
        symmetry: how they did on symmetric scenes; None where frame errors are too small for it to matter.
        comparisons: the best of the methods measured now against each other one.
        gallery: pairs that are drawn.
        attention: by method, pictures of what it looks at, pair by pair of the gallery.
        dataset: its folder.
        versions: of packages.
    """

    conditions: Conditions
    found: Mapping[str, Outcomes]
    rows: Mapping[str, MeasuredRow]
    pairs: Pairs
    symmetry: Symmetry | None
    comparisons: Sequence[Comparison]
    gallery: Sequence[Shown]
    attention: Mapping[str, Sequence[Panel]]
    dataset: str
    versions: Mapping[str, str]


def frame_error_part(content: FrameErrorContent) -> ReportPart:
    """The part; sections that have nothing to tell are left out."""
    sections = [
        ("table-1", "Table I", _table_one(content)),
        ("overlap", "By overlap", _overlap(content)),
        ("symmetry", "Symmetric scenes apart", symmetry_section(content.symmetry)),
        ("better", "Who is better", _comparisons(content)),
        ("errors", "How errors are spread", _spread(content)),
        ("gallery", "Pairs", gallery_section(content.gallery, reference=ranking(content.found)[0])),
        ("calibration", "Does a method know its error?", _calibration(content)),
        ("training", "Error against training samples", _curves(content)),
        ("attention", "What the transformer looks at", attention_section(content.attention)),
        ("time", "Time, and the error that is left", _time(content)),
        ("origin", "How it was made", _origin(content)),
    ]
    return ReportPart(
        key=KEY,
        title="Frame error: how well two robots' maps are brought together",
        lead=_lead(content),
        facts=_facts(content.conditions),
        sections=tuple(
            ReportSection(anchor=anchor, heading=heading, body=joined(*pieces))
            for anchor, heading, pieces in sections
            if pieces
        ),
    )


def _lead(content: FrameErrorContent) -> Html:
    ranked = ranking(content.found)
    best = content.rows[ranked[0]].summary.overall
    line: list[Piece] = [
        strong(title(ranked[0])),
        f" has the smallest mean error of what was measured here: {best.position_m.value:.3f} m and "
        f"{math.degrees(best.heading_rad.value):.2f}°, within {SUCCESS_M:g} m and "
        f"{math.degrees(SUCCESS_RAD):.0f}° in {share_words(best.success.value)} of pairs.",
    ]
    if len(ranked) > 1:
        second = content.rows[ranked[1]].summary.overall
        line.append(
            f" Next is {title(ranked[1])} with {second.position_m.value:.3f} m and "
            f"{math.degrees(second.heading_rad.value):.2f}°, {share_words(second.success.value)}."
        )
    return paragraph(*line, kind="lead")


def _facts(c: Conditions) -> tuple[tuple[str, str], ...]:
    return (
        ("split", c.split),
        ("pairs", f"{c.pairs:,}"),
        ("floor plans", f"{c.plans:,}"),
        ("frame error drawn from", f"±{c.xy_range_m:g} m, ±{c.yaw_range_deg:g}°"),
        ("data", c.data_digest[:12]),
        ("seed", str(c.seed)),
    )


def _table_one(content: FrameErrorContent) -> list[Html]:
    return [
        paragraph(TASK),
        table_one(content.rows, list(content.found)),
        paragraph(table_one_note(content.conditions), kind="note"),
    ]


def _overlap(content: FrameErrorContent) -> list[Html]:
    return [overlap_table(content.rows, list(content.found)), paragraph(OVERLAP, kind="note")]


def _comparisons(content: FrameErrorContent) -> list[Html]:
    if not content.comparisons:
        return []
    note = comparison_note(len(content.comparisons))
    return [comparison_table(content.comparisons), paragraph(note, kind="note")]


def _spread(content: FrameErrorContent) -> list[Html]:
    return [
        figure(
            scatter_chart(content.found, content.pairs),
            "Position error against overlap (the paper's Fig. 6a), a dot for each pair. Black: the median in "
            f"each bin of overlap. Dashed: {SUCCESS_M:g} m. Rings: no estimate.",
            alt="Position error against overlap",
        ),
        figure(
            cdf_chart(content.found),
            "Share of pairs whose error is below; pairs without an estimate never are. "
            f"Dashed: {SUCCESS_M:g} m and {math.degrees(SUCCESS_RAD):.0f}°.",
            alt="Cumulative distribution of the errors",
        ),
    ]


def _calibration(content: FrameErrorContent) -> list[Html]:
    chart = calibration_chart(content.found)
    return [
        paragraph(
            f"A fusion can refuse what is uncertain, so a method should say so. Wrong is an error above "
            f"{WRONG_M:g} m or {math.degrees(WRONG_RAD):.0f}°. Flagged is an estimate that the method itself "
            "calls ambiguous, or none. Covariances are tested on the estimates that are not flagged: of the "
            f"errors, 50, 90 and 95 % should lie inside the ellipsoids of those probabilities. {SHARES}"
        ),
        calibration_table(content.rows, list(content.found)),
        *(
            []
            if chart is None
            else [
                figure(
                    chart,
                    "Below the diagonal a method is too sure of itself, above it too careful.",
                    alt="Coverage of the covariances",
                )
            ]
        ),
    ]


def _curves(content: FrameErrorContent) -> list[Html]:
    curves = {
        name: row.training.curve
        for name, row in content.rows.items()
        if row.training is not None and row.training.curve is not None
    }
    chart = curve_chart(curves)
    if chart is None:
        return []
    return [
        figure(
            chart,
            "On validation pairs, while training; dashed where the error was still falling at the end.",
            alt="Validation error against training samples",
        )
    ]


def _time(content: FrameErrorContent) -> list[Html]:
    return [
        time_table(content.rows, list(content.found)),
        paragraph(
            f"On {content.conditions.hardware}. Methods without a network run in as many processes as there "
            "are workers, one thread each; networks in one process with all threads. The last column of "
            "figures is how far the corrected transform T̂ puts robot 1 from where it stands.",
            kind="note",
        ),
    ]


def _origin(content: FrameErrorContent) -> list[Html]:
    c = content.conditions
    told = [
        ("dataset", f"{content.dataset}, split {c.split}"),
        ("digest of the pairs", c.data_digest),
        ("digest of the frame errors", c.perturbation_digest),
        ("seed of the frame errors", str(c.seed)),
        ("commit", c.commit or "not known"),
        ("hardware", c.hardware),
        *((f"weights of {title(n)}", w) for n, w in _weights(content.rows).items()),
        *content.versions.items(),
    ]
    return [
        origin_table(told),
        paragraph(
            "Beside this page lie the frame errors of all pairs, ",
            Html("<code>perturbations.json</code>"),
            ", and all figures, ",
            Html("<code>metrics.json</code>"),
            ".",
        ),
    ]


def _weights(rows: Mapping[str, MeasuredRow]) -> dict[str, str]:
    return {n: row.training.weights_digest for n, row in rows.items() if row.training is not None}
