"""Charts of the report on frame-error estimators, as inline SVG, from an `outcome_table`."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from rendezvous.evaluation.frame_error.calibration import LEVELS, Spreads
from rendezvous.evaluation.frame_error.estimates import OVERLAP_EDGES, SUCCESS_M, SUCCESS_RAD
from rendezvous.evaluation.frame_error.training_curve import TrainingCurve, doubt
from rendezvous.evaluation.report.charts import INK, MUTED, chart, plain_numbers, svg
from rendezvous.methods import Method

if TYPE_CHECKING:
    from markupsafe import Markup
    from matplotlib.axes import Axes

Methods = Mapping[str, Method]

_LEAST_M, _MOST_M = 0.004, 12.0
_LEAST_DEG, _MOST_DEG = 0.05, 180.0
_COLUMNS = 4
_BEYOND = 1e6
"""Drawn instead of the error of a failure, outside every axis."""
_DASHED: dict[str, Any] = {"color": MUTED, "lw": 0.8, "ls": (0, (4, 3))}


def scatter_chart(outcomes: pd.DataFrame, methods: Methods) -> Markup:
    """Fig. 6a: position error against overlap, a panel for each method; the median of each bin of overlap."""
    groups = outcomes.groupby("method", sort=False)
    columns = min(_COLUMNS, len(groups))
    rows = -(-len(groups) // columns)
    with chart(0.6 + 2.5 * rows) as figure:
        axes = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False).ravel()
        for axis, (name, found) in zip(axes, groups, strict=False):
            _scatter(axis, methods[str(name)], found)
        for number, axis in enumerate(axes):
            axis.set_visible(number < len(groups))
            axis.tick_params(labelbottom=number + columns >= len(groups))
        figure.supxlabel("overlap", fontsize=9.5)
        figure.supylabel("position error [m]", fontsize=9.5)
        return svg(figure)


def _scatter(axis: Axes, method: Method, found: pd.DataFrame) -> None:
    error_m = found["position_m"].clip(_LEAST_M, _MOST_M)
    failed = found["failed"]
    made: dict[str, Any] = {
        "s": 9,
        "color": method.colour,
        "alpha": 0.55,
        "linewidths": 0,
        "rasterized": True,
    }
    axis.scatter(found["overlap"][~failed], error_m[~failed], **made)
    axis.scatter(found["overlap"][failed], error_m[failed], s=14, facecolors="none", edgecolors=INK, lw=0.6)
    edges = [0.0, *OVERLAP_EDGES, max(1.0, found["overlap"].max())]
    medians_m = error_m.groupby(found["overlaps"], observed=False).median()
    for left, right, median_m in zip(edges, edges[1:], medians_m, strict=False):
        axis.plot([left, right], [median_m] * 2, color=INK, lw=1.8, solid_capstyle="butt")
    axis.axhline(SUCCESS_M, **_DASHED)
    axis.set(yscale="log", ylim=(_LEAST_M, _MOST_M), xlim=(0.0, 1.0), title=method.title)
    plain_numbers(axis.yaxis)


def cdf_chart(outcomes: pd.DataFrame, methods: Methods) -> Markup:
    """Share of pairs with an error below each bound, in position and in heading."""
    with chart(4.2) as figure:
        left, right = figure.subplots(1, 2, sharey=True)
        for name, found in outcomes.groupby("method", sort=False):
            method = methods[str(name)]
            style: dict[str, Any] = {"color": method.colour, "lw": 1.8, "label": method.title}
            left.ecdf(found["position_m"].mask(found["failed"], _BEYOND).clip(_LEAST_M), **style)
            heading_deg = np.degrees(found["heading_rad"])
            right.ecdf(heading_deg.mask(found["failed"], _BEYOND).clip(_LEAST_DEG), **style)
        left.axvline(SUCCESS_M, **_DASHED)
        right.axvline(np.degrees(SUCCESS_RAD), **_DASHED)
        left.set(xscale="log", xlim=(_LEAST_M, _MOST_M), ylim=(0.0, 1.0), xlabel="position error [m]")
        left.set_ylabel("share of pairs below")
        right.set(xscale="log", xlim=(_LEAST_DEG, _MOST_DEG), xlabel="heading error [°]")
        for axis in (left, right):
            plain_numbers(axis.xaxis)
        figure.legend(*left.get_legend_handles_labels(), loc="outside upper left", ncols=_COLUMNS)
        return svg(figure)


def calibration_chart(outcomes: pd.DataFrame, methods: Methods) -> Markup | None:
    """Share of errors inside the ellipsoid of each probability; None if no method gives covariances."""
    groups = {str(name): rows for name, rows in outcomes.groupby("method", sort=False)}
    known = {name: rows for name, rows in groups.items() if len(Spreads.of(rows))}
    if not known:
        return None
    with chart(4.4) as figure:
        panels = figure.subplots(1, 2, sharey=True)
        for axis, title in zip(panels, ("not flagged", "all estimates"), strict=True):
            axis.plot([0, 1], [0, 1], **_DASHED)
            for name, rows in known.items():
                spreads = Spreads.of(rows[~rows["flagged"]] if title == "not flagged" else rows)
                if len(spreads):
                    method = methods[name]
                    axis.ecdf(spreads.probability, color=method.colour, lw=1.8, label=method.title)
            axis.set(xlim=(0, 1), ylim=(0, 1), title=title, xlabel="probability of the ellipsoid")
            for level in LEVELS:
                axis.axvline(level, color=MUTED, lw=0.8, ls=(0, (1, 3)))
        panels[0].set_ylabel("share of errors inside")
        figure.legend(*panels[1].get_legend_handles_labels(), loc="outside upper left", ncols=_COLUMNS)
        return svg(figure)


def curve_chart(curves: Mapping[str, TrainingCurve], methods: Methods) -> Markup | None:
    """Validation error against training samples; None if there are no curves."""
    curves = {name: curve for name, curve in curves.items() if len(curve.samples)}
    if not curves:
        return None
    with chart(4.2) as figure:
        left, right = figure.subplots(1, 2)
        for name, curve in curves.items():
            title, against = methods[name].title, doubt(curve)
            style: dict[str, Any] = {
                "color": methods[name].colour,
                "lw": 1.8,
                "ls": (0, (5, 2)) if against else "-",
                "marker": "o",
                "ms": 3,
                "label": f"{title}, {against}" if against else title,
            }
            left.plot(curve.samples, curve.position_m, **style)
            right.plot(curve.samples, np.degrees(curve.yaw_rad), **style)
        left.set_ylabel("mean |x|, |y| error [m]")
        right.set_ylabel("mean heading error [°]")
        for axis in (left, right):
            axis.set(xscale="log", yscale="log", xlabel="training samples")
            plain_numbers(axis.xaxis, digits=(1.0, 2.0, 5.0))
            plain_numbers(axis.yaxis, digits=(1.0, 2.0, 3.0, 5.0, 7.0))
        figure.legend(*left.get_legend_handles_labels(), loc="outside upper left", ncols=_COLUMNS - 1)
        return svg(figure)
