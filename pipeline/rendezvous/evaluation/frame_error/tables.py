"""Tables of the report on frame-error estimators."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

from rendezvous.evaluation.frame_error.calibration import LEVELS, Calibration
from rendezvous.evaluation.frame_error.measured_row import Conditions, MeasuredRow
from rendezvous.evaluation.frame_error.summary import OVERLAP_BINS, Accuracy, Comparison
from rendezvous.evaluation.frame_error.table_one import ABLATION, HOUGH, OWN_METHODS, PAPER, PaperRow, title
from rendezvous.evaluation.frame_error.training_curve import doubt
from rendezvous.evaluation.report.html_page import Cell, Html, badge, joined, table
from rendezvous.evaluation.statistics import Interval

_DASH = "–"
Rows = Mapping[str, MeasuredRow]


def table_one(rows: Rows, measured: Sequence[str]) -> Html:
    """Table I: the paper's rows beside ours, then what the paper has not.

    Args:
        rows: by method, measured now or recorded.
        measured: which of them now.
    """
    header = [
        [
            ("", 4),
            ("paper, on its own pairs", 3),
            ("here, mean absolute error", 3),
            ("median", 3),
            ("", 3),
        ],
        [(word, 1) for word in ("method", "ViT", "Reg", "Lie")]
        + [(word, 1) for word in ("Δx m", "Δy m", "Δψ rad")]
        + [(word, 1) for word in ("Δx m", "Δy m", "Δψ rad", "Δx", "Δy", "Δψ")]
        + [(word, 1) for word in ("success", "95 % below", "no estimate")],
    ]
    best = _best({name: rows[name] for name in measured})
    own = [name for name in OWN_METHODS if name in rows]
    body: list[list[Cell | None]] = [_table_one_row(row.name, rows, measured, best) for row in ABLATION]
    return table(header, [*body, [None], *(_table_one_row(name, rows, measured, best) for name in own)])


def _table_one_row(
    name: str, rows: Rows, measured: Sequence[str], best: Mapping[str, str]
) -> list[Cell | None]:
    first = [
        _method(name, rows, measured),
        *_switches(PAPER.get(name)),
        *_printed(PAPER.get(name)),
    ]
    if name not in rows:
        return [*first, *(Cell(main=_DASH) for _ in range(9))]
    found = rows[name].summary.overall
    return [
        *first,
        *(
            Cell(main=_number(mean.value, 3), small=_range(mean, 3), best=best.get(component) == name)
            for component, mean in zip("xyψ", found.mean, strict=True)
        ),
        *(Cell(main=_number(value, 3)) for value in found.median),
        Cell(
            main=share_words(found.success.value),
            small=_share_range(found.success),
            best=best.get("success") == name,
        ),
        Cell(main=f"{found.position_p95_m:.2f} m", small=f"{math.degrees(found.heading_p95_rad):.1f}°"),
        Cell(main=share_words(found.failures)),
    ]


def _best(rows: Rows) -> dict[str, str]:
    """Who has the smallest mean of each component, and the most successes."""
    if not rows:
        return {}
    means = {
        component: min(rows, key=lambda name: rows[name].summary.overall.mean[k].value)
        for k, component in enumerate("xyψ")
    }
    return means | {"success": max(rows, key=lambda name: rows[name].summary.overall.success.value)}


def _switches(row: PaperRow | None) -> list[Cell]:
    values = (None, None, None) if row is None else (row.vit, row.reg, row.lie)
    return [Cell(main="✓" if value else _DASH if value is False else "", kind="switch") for value in values]


def _printed(row: PaperRow | None) -> list[Cell]:
    values = ("", "", "") if row is None else tuple(f"{v:.3f}" for v in (row.x_m, row.y_m, row.yaw_rad))
    x, y, yaw = (Cell(main=value, kind="paper") for value in values)
    return [replace(x, small="presumably") if row == HOUGH else x, y, yaw]


def _method(name: str, rows: Rows, measured: Sequence[str]) -> Cell:
    """The method, where its figures are from, and what should make one doubt them."""
    if name not in rows:
        return Cell(main=joined(title(name), " ", badge("not trained", "missing")), kind="name source")
    row = rows[name]
    where = badge("measured", "measured") if name in measured else badge("recorded", "recorded")
    told = [] if name in measured else [_conditions(row.conditions, rows[measured[0]].conditions)]
    if row.training is not None:
        t = row.training
        minutes = "" if t.minutes is None else f", {t.minutes:.1f} min"
        told.append(f"seed {t.seed}, {t.samples:,} samples{minutes}")
        if row.plans_trained_on is None:
            told.append("whether it was trained on these plans is not known")
    badges = [joined(" ", badge(words, "warning")) for words in _warnings(row)]
    main = joined(title(name), " ", where, *badges)
    return Cell(main=main, small="; ".join(told), kind="name source")


def _warnings(row: MeasuredRow) -> list[str]:
    """What should make one doubt the figures of a learned method."""
    if row.training is None:
        return []
    missed = row.not_learned
    against = f"has not learned {' or '.join(missed)}" if missed else doubt(row.training.curve)
    known, plans = row.plans_trained_on, row.conditions.plans
    return [
        *([against] if against else []),
        *([f"trained on {known} of these {plans} plans"] if known else []),
    ]


def _conditions(c: Conditions, here: Conditions) -> str:
    """What a recorded row was measured on, and what it has in common with the measured ones."""
    commit = f", commit {c.commit[:9]}" if c.commit else ""
    other = "" if c.same_pairs(here) else f", not the {here.pairs:,} of {here.split} measured here"
    return f"{c.pairs:,} pairs of {c.split}{other}, data {c.data_digest[:9]}{commit}"


def _name(name: str, rows: Rows, measured: Sequence[str]) -> Cell:
    c = rows[name].conditions
    small = "" if name in measured else f"recorded, {c.pairs:,} pairs of {c.split}"
    return Cell(main=title(name), small=small, kind="name")


def overlap_table(rows: Rows, measured: Sequence[str]) -> Html:
    """Errors and successes by overlap; the pairs of a recorded row may be others than those counted."""
    sizes = rows[measured[0]].summary.by_overlap
    bins = [
        (f"overlap {name}, {found.count} pairs" if found else f"overlap {name}, none", 3)
        for name, found in zip(OVERLAP_BINS, sizes, strict=True)
    ]
    header = [
        [("", 1), *bins],
        [("method", 1), *((word, 1) for _ in bins for word in ("position m", "heading °", "success"))],
    ]
    body: list[list[Cell | None]] = []
    for name, row in rows.items():
        cells: list[Cell | None] = [_name(name, rows, measured)]
        for b, found in enumerate(row.summary.by_overlap):
            cells += accuracy_cells(found, best=_best_of_bin({n: rows[n] for n in measured}, b) == name)
        body.append(cells)
    return table(header, body)


def _best_of_bin(rows: Rows, b: int) -> str | None:
    there = {name: found for name, row in rows.items() if (found := row.summary.by_overlap[b])}
    return min(there, key=lambda name: there[name].position_m.value, default=None)


def accuracy_cells(found: Accuracy | None, *, best: bool = False) -> list[Cell]:
    """Position, heading and success over some of the pairs."""
    if found is None:
        return [Cell(main=_DASH)] * 3
    heading = found.heading_rad.scaled(180.0 / math.pi)
    return [
        Cell(main=_number(found.position_m.value, 3), small=_range(found.position_m, 2), best=best),
        Cell(main=_number(heading.value, 2), small=_range(heading, 1)),
        Cell(main=share_words(found.success.value), small=_share_range(found.success)),
    ]


def comparison_table(found: Sequence[Comparison]) -> Html:
    """Who is better than whom, and whether that is beyond doubt."""
    header = [[(w, 1) for w in ("method", "against", "position m", "heading °", "success, points", "")]]
    body: list[list[Cell | None]] = []
    for c in found:
        heading, success = c.heading_rad.scaled(180.0 / math.pi), c.success.scaled(100.0)
        body.append(
            [
                Cell(main=title(c.better), kind="name"),
                Cell(main=title(c.other), kind="name"),
                *(
                    Cell(main=_signed(value, decimals), small=_range(value, decimals))
                    for value, decimals in ((c.position_m, 3), (heading, 2), (success, 1))
                ),
                Cell(main=_verdict(c), kind="words"),
            ]
        )
    return table(header, body)


def _verdict(c: Comparison) -> str:
    """What the intervals leave no doubt about."""
    gains = {
        "position": c.position_m.scaled(-1.0),
        "heading": c.heading_rad.scaled(-1.0),
        "success": c.success,
    }
    sure = {name: gain for name, gain in gains.items() if gain.excludes_zero}
    better = [name for name, gain in sure.items() if gain.value > 0.0]
    worse = [name for name, gain in sure.items() if gain.value < 0.0]
    words = [
        f"{word} in {', '.join(names)}" for word, names in (("better", better), ("worse", worse)) if names
    ]
    return "; ".join(words) or "no difference beyond doubt"


def calibration_table(rows: Rows, measured: Sequence[str]) -> Html:
    """What methods say of their own errors."""
    header = [
        [
            ("", 1),
            ("flags", 3),
            ("errors inside the ellipsoid of", 3),
            ("NEES (right: 3; normal: 2.37)", 2),
            ("negative log density", 2),
        ],
        [(w, 1) for w in ("method", "flagged", "wrong, not flagged", "wrong, flagged")]
        + [(f"{100 * level:.0f} %", 1) for level in LEVELS]
        + [(w, 1) for w in ("mean", "median", "by covariance", "own posterior")],
    ]
    body: list[list[Cell | None]] = []
    for name, row in rows.items():
        w = row.summary.warnings
        body.append(
            [
                _name(name, rows, measured),
                *(
                    Cell(main=share_words(share.value), small=_share_range(share))
                    for share in (w.flagged, w.wrong_unflagged, w.wrong_flagged)
                ),
                *_calibration_cells(row.summary.calibration_unflagged),
            ]
        )
    return table(header, body)


def _calibration_cells(found: Calibration | None) -> list[Cell]:
    if found is None:
        return [Cell(main=_DASH)] * 7
    return [
        *(Cell(main=share_words(share.value), small=_share_range(share)) for share in found.coverage),
        Cell(main=_number(found.nees_mean, 2)),
        Cell(main=_number(found.nees_median, 2)),
        Cell(main=_number(found.spread_nll, 2)),
        Cell(main=_DASH if found.posterior_nll is None else _number(found.posterior_nll, 2)),
    ]


def time_table(rows: Rows, measured: Sequence[str]) -> Html:
    """Time per pair, and by how far robot 1 is misplaced in the end."""
    header = [[(w, 1) for w in ("method", "median ms", "95 % below ms", "T̂ misplaces robot 1 by m", "")]]
    body: list[list[Cell | None]] = [
        [
            _name(name, rows, measured),
            Cell(main=f"{1000.0 * row.summary.duration_median_s:.1f}"),
            Cell(main=f"{1000.0 * row.summary.duration_p95_s:.1f}"),
            Cell(
                main=_number(row.summary.overall.meeting_m.value, 3),
                small=_range(row.summary.overall.meeting_m, 3),
            ),
            Cell(main=row.conditions.hardware if name not in measured else "", kind="words"),
        ]
        for name, row in rows.items()
    ]
    return table(header, body)


def _number(value: float, decimals: int) -> str:
    return f"{value:.{decimals}f}" if math.isfinite(value) else ("∞" if value > 0 else _DASH)


def _signed(value: Interval, decimals: int) -> str:
    return f"{value.value:+.{decimals}f}".replace("-", "−")


def _range(value: Interval, decimals: int) -> str:
    return f"{_number(value.low, decimals)} … {_number(value.high, decimals)}".replace("-", "−")


def share_words(value: float) -> str:
    """A share in percent."""
    return f"{100.0 * value:.1f} %" if math.isfinite(value) else _DASH


def _share_range(value: Interval) -> str:
    return f"{100.0 * value.low:.1f} … {100.0 * value.high:.1f}" if math.isfinite(value.low) else ""
