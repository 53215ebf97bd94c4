"""Charts of the report on frame-error estimators, each as inline SVG."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from rendezvous.alignment.spread import ellipsoid_probability, nees
from rendezvous.evaluation.frame_error.calibration import LEVELS
from rendezvous.evaluation.frame_error.estimates import SUCCESS_M, SUCCESS_RAD, Outcomes, Pairs
from rendezvous.evaluation.frame_error.summary import OVERLAP_EDGES
from rendezvous.evaluation.frame_error.table_one import title
from rendezvous.evaluation.frame_error.training_curve import TrainingCurve, doubt
from rendezvous.evaluation.pictures.canvas import BLUE, RED, Colour
from rendezvous.evaluation.report.charts import INK, MUTED, chart, plain_numbers, rgb, svg
from rendezvous.geometry.occupancy_grid import Mask

if TYPE_CHECKING:
    from markupsafe import Markup
    from matplotlib.axes import Axes

COLOURS: dict[str, Colour] = {
    "identity": (150, 154, 162),
    "hough": (214, 138, 28),
    "hough-global": (240, 190, 102),
    "orb": (74, 145, 74),
    "correlative": RED,
    "matcher-maps": (140, 178, 226),
    "matcher": BLUE,
    "cnn": (126, 196, 193),
    "cnn-lie": (66, 160, 158),
    "cnn-reg": (158, 214, 180),
    "cnn-reg-lie": (28, 116, 116),
    "vit": (214, 178, 224),
    "vit-lie": (176, 108, 190),
    "vit-reg": (232, 158, 196),
    "vit-reg-lie": (112, 44, 132),
}

_LEAST_M, _MOST_M = 0.004, 12.0
_LEAST_DEG, _MOST_DEG = 0.05, 180.0
_COLUMNS = 4


def scatter_chart(found: Mapping[str, Outcomes], pairs: Pairs) -> Markup:
    """Fig. 6a: error against overlap, a panel for each method, with the median in each bin of overlap."""
    columns = min(_COLUMNS, len(found))
    rows = -(-len(found) // columns)
    with chart(0.6 + 2.5 * rows) as figure:
        axes = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False).ravel()
        for axis, (name, outcomes) in zip(axes, found.items(), strict=False):
            _scatter(axis, name, outcomes, pairs)
        for number, axis in enumerate(axes):
            axis.set_visible(number < len(found))
            axis.tick_params(labelbottom=number + columns >= len(found))
        figure.supxlabel("overlap", fontsize=9.5)
        figure.supylabel("position error [m]", fontsize=9.5)
        return svg(figure)


def _scatter(axis: Axes, name: str, outcomes: Outcomes, pairs: Pairs) -> None:
    error_m = outcomes.position_m.clip(_LEAST_M, _MOST_M)
    good = ~outcomes.failed
    axis.scatter(
        pairs.overlap[good],
        error_m[good],
        s=9,
        color=rgb(COLOURS[name]),
        alpha=0.55,
        linewidths=0,
        rasterized=True,
    )
    axis.scatter(pairs.overlap[~good], error_m[~good], s=14, facecolors="none", edgecolors=INK, lw=0.6)
    edges = np.array([0.0, *OVERLAP_EDGES, max(1.0, float(pairs.overlap.max()))])
    bins = np.digitize(pairs.overlap, OVERLAP_EDGES)
    for b in np.unique(bins):
        median_m = float(np.median(error_m[bins == b]))
        axis.plot(edges[b : b + 2], [median_m, median_m], color=INK, lw=1.8, solid_capstyle="butt")
    axis.axhline(SUCCESS_M, color=MUTED, lw=0.8, ls=(0, (4, 3)))
    axis.set(yscale="log", ylim=(_LEAST_M, _MOST_M), xlim=(0.0, 1.0), title=title(name))
    plain_numbers(axis.yaxis)


def cdf_chart(found: Mapping[str, Outcomes]) -> Markup:
    """Share of pairs with an error below each bound, in position and in heading."""
    with chart(4.2) as figure:
        left, right = figure.subplots(1, 2, sharey=True)
        for name, outcomes in found.items():
            heading_deg = np.degrees(outcomes.heading_rad)
            _step(left, np.where(outcomes.failed, np.inf, outcomes.position_m), _LEAST_M, _MOST_M, name)
            _step(right, np.where(outcomes.failed, np.inf, heading_deg), _LEAST_DEG, _MOST_DEG, name)
        left.axvline(SUCCESS_M, color=MUTED, lw=0.8, ls=(0, (4, 3)))
        right.axvline(np.degrees(SUCCESS_RAD), color=MUTED, lw=0.8, ls=(0, (4, 3)))
        left.set(xscale="log", xlim=(_LEAST_M, _MOST_M), ylim=(0.0, 1.0), xlabel="position error [m]")
        left.set_ylabel("share of pairs below")
        right.set(xscale="log", xlim=(_LEAST_DEG, _MOST_DEG), xlabel="heading error [°]")
        for axis in (left, right):
            plain_numbers(axis.xaxis)
        figure.legend(*left.get_legend_handles_labels(), loc="outside upper left", ncols=_COLUMNS)
        return svg(figure)


def _step(axis: Axes, error: Any, least: float, most: float, name: str) -> None:
    ordered = np.sort(error).clip(least, None)
    share = np.arange(1, len(ordered) + 1) / len(ordered)
    shown = np.isfinite(ordered)
    x = np.concatenate([[least], ordered[shown], [most]])
    last = float(share[shown][-1]) if shown.any() else 0.0
    y = np.concatenate([[0.0], share[shown], [last]])
    axis.step(x, y, where="post", color=rgb(COLOURS[name]), lw=1.8, label=title(name))


def calibration_chart(found: Mapping[str, Outcomes]) -> Markup | None:
    """Share of errors inside the ellipsoid of each probability; None if no method gives covariances."""
    known = {name: outcomes for name, outcomes in found.items() if _with_covariance(outcomes).any()}
    if not known:
        return None
    with chart(4.4) as figure:
        panels = figure.subplots(1, 2, sharey=True)
        for axis, words in zip(panels, ("not flagged", "all estimates"), strict=True):
            axis.plot([0, 1], [0, 1], color=MUTED, lw=1.0, ls=(0, (4, 3)))
            for name, outcomes in known.items():
                chosen = _with_covariance(outcomes)
                _probabilities(
                    axis, name, outcomes, chosen & ~outcomes.flagged if words == "not flagged" else chosen
                )
            axis.set(xlim=(0, 1), ylim=(0, 1), title=words)
            for level in LEVELS:
                axis.axvline(level, color=MUTED, lw=0.8, ls=(0, (1, 3)))
            axis.set_xlabel("probability of the ellipsoid")
        panels[0].set_ylabel("share of errors inside")
        figure.legend(*panels[1].get_legend_handles_labels(), loc="outside upper left", ncols=_COLUMNS)
        return svg(figure)


def _probabilities(axis: Axes, name: str, outcomes: Outcomes, chosen: Mask) -> None:
    if not chosen.any():
        return
    distance = nees(outcomes.error[chosen], outcomes.covariance[chosen])
    inside = np.sort(ellipsoid_probability(distance, outcomes.degrees_of_freedom[chosen]))
    share = np.arange(1, len(inside) + 1) / len(inside)
    x, y = np.concatenate([[0.0], inside, [1.0]]), np.concatenate([[0.0], share, [share[-1]]])
    axis.step(x, y, where="post", color=rgb(COLOURS[name]), lw=1.8, label=title(name))


def curve_chart(curves: Mapping[str, TrainingCurve]) -> Markup | None:
    """Validation error against training samples; None if there are no curves."""
    curves = {name: curve for name, curve in curves.items() if len(curve.samples)}
    if not curves:
        return None
    with chart(4.2) as figure:
        left, right = figure.subplots(1, 2)
        for name, curve in curves.items():
            against = doubt(curve)
            style = {"color": rgb(COLOURS[name]), "lw": 1.8, "ls": (0, (5, 2)) if against else "-"}
            label = f"{title(name)}, {against}" if against else title(name)
            left.plot(curve.samples, curve.position_m, marker="o", ms=3, label=label, **style)
            right.plot(curve.samples, np.degrees(curve.yaw_rad), marker="o", ms=3, **style)
        left.set(xscale="log", yscale="log", xlabel="training samples", ylabel="mean |x|, |y| error [m]")
        right.set(xscale="log", yscale="log", xlabel="training samples", ylabel="mean heading error [°]")
        for axis in (left, right):
            plain_numbers(axis.xaxis, digits=(1.0, 2.0, 5.0))
            plain_numbers(axis.yaxis, digits=(1.0, 2.0, 3.0, 5.0, 7.0))
        figure.legend(*left.get_legend_handles_labels(), loc="outside upper left", ncols=_COLUMNS - 1)
        return svg(figure)


def _with_covariance(outcomes: Outcomes) -> Mask:
    return ~outcomes.failed & np.isfinite(outcomes.covariance).all(axis=(1, 2))
