"""Box plots over violin plots of errors by group, as the paper's Fig. 5 shows them.

Groups lie below each other and components side by side, so that groups have room for their names.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
import seaborn as sns
from markupsafe import Markup

from rendezvous.evaluation.pictures.canvas import BLUE
from rendezvous.evaluation.report.charts import INK, LINE, MUTED, chart, rgb, svg
from rendezvous.geometry.se2 import Array

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_HEADER_IN, _GROUP_IN = 1.0, 0.62
_LEAST_VIOLIN = 10
"""Fewer values are drawn as dots, because their density is not known."""
_LEAST_BANDWIDTH = 0.004
"""As a share of the axis, so that nearly equal values have a density as well."""
_WHISKER_IQR = 1.5
_BEYOND_WHISKERS = 1.25
_NOTE: dict[str, Any] = {"xycoords": ("axes fraction", "data"), "ha": "right", "size": 7.5, "color": MUTED}
_LINE = {"color": INK, "linewidth": 1.0}
_BOX = {"facecolor": LINE, "edgecolor": INK, "linewidth": 1.0}
_DOTS: dict[str, Any] = {
    "marker": "o",
    "linestyle": "",
    "markersize": 2.5,
    "markeredgewidth": 0,
    "markerfacecolor": rgb(BLUE),
    "alpha": 0.6,
}


@dataclass(frozen=True, slots=True, kw_only=True)
class Component:
    """One component of the errors, a panel of the chart."""

    column: str  # of the table of errors
    name: str  # e.g. Δx
    unit: str  # of the values, e.g. m or °
    # Its limits; None for all whiskers with a margin, and zero in the middle if a value is negative.
    axis: tuple[float, float] | None = None
    label: str = ""  # below the axis; by default "error" and the unit


def violin_chart(errors: pd.DataFrame, by: str, components: Sequence[Component]) -> Markup:
    """Errors by group: violins; boxes with median, quartiles and whiskers; dots beyond those.

    A row with a NaN is an estimate that was not made: the label of its group says "n = made of all". Notes
    tell the share of values beyond the axis.

    Args:
        errors: one row per estimate, with a column for each component.
        by: the categorical column of groups, from the top down; empty groups are left out.
        components: from the left.

    Returns:
        Inline SVG.
    """
    with chart(_HEADER_IN + _GROUP_IN * errors[by].nunique()) as figure:
        draw_violins(figure, errors, by, components)
        return svg(figure)


def draw_violins(
    figure: Figure, errors: pd.DataFrame, by: str, components: Sequence[Component]
) -> Sequence[Axes]:
    """Draw `violin_chart` on a figure; returns the panel of each component."""
    groups = [str(name) for name in errors[by].cat.remove_unused_categories().cat.categories]
    values = errors.dropna(subset=[component.column for component in components])
    made, asked = (rows[by].value_counts() for rows in (values, errors))
    labels = [
        f"{name}\nn = {made[name]:,}" + (f" of {asked[name]:,}" if made[name] < asked[name] else "")
        for name in groups
    ]
    panels = figure.subplots(1, len(components), sharey=True, squeeze=False).ravel()
    for panel, component in zip(panels, components, strict=True):
        grouped = [values[component.column][values[by] == name].to_numpy() for name in groups]
        limits = component.axis or _limits(grouped)
        _draw(panel, grouped, limits)
        panel.locator_params(axis="x", nbins=5)  # more run into each other
        panel.set(xlim=limits, title=component.name, xlabel=component.label or f"error [{component.unit}]")
        panel.grid(visible=False, axis="y")
    panels[0].set_yticks(range(len(groups)), labels, color=INK)
    panels[0].set_ylim(len(groups) - 0.5, -0.5)
    return list(panels)


def _draw(panel: Axes, grouped: Sequence[Array], limits: tuple[float, float]) -> None:
    shown = [values[(values >= limits[0]) & (values <= limits[1])] for values in grouped]
    dense = {row: values for row, values in enumerate(shown) if len(values) >= _LEAST_VIOLIN}
    if dense:
        # Violins end with their values, those of distances at zero. Seaborn scales widths by the least gap.
        gap = np.diff(list(dense)).min(initial=len(grouped)) if len(dense) > 1 else 1
        sns.violinplot(
            dense, ax=panel, orient="y", native_scale=True, color=rgb(BLUE), saturation=1, alpha=0.3,
            linewidth=0, inner=None, cut=0, density_norm="width", width=0.72 / gap, gridsize=201,
            bw_method=lambda kde: _bandwidth(kde.dataset[0], limits),
        )  # fmt: skip
    for row, (values, inside) in enumerate(zip(grouped, shown, strict=True)):
        if not len(values):
            panel.annotate("none", (1.0, row), **_NOTE)
            continue
        panel.boxplot(
            values, positions=[row], widths=0.18, whis=_WHISKER_IQR, orientation="horizontal",
            manage_ticks=False, showcaps=False, patch_artist=True, boxprops=_BOX, whiskerprops=_LINE,
            medianprops=_LINE | {"linewidth": 2.2}, showfliers=row in dense, flierprops=_DOTS,
        )  # fmt: skip
        if row not in dense:
            panel.plot(values, np.full(len(values), row + 0.225), **_DOTS)
        if len(inside) < len(values):
            beyond = 100.0 * (1.0 - len(inside) / len(values))
            panel.annotate(f"{beyond:.1f} % beyond", (1.0, row - 0.3), **_NOTE)
    panel.axvline(0.0, color=MUTED, lw=0.8)


def _bandwidth(values: Array, limits: tuple[float, float]) -> float:
    """Silverman's bandwidth (1986, Eq. 3.31) as scipy wants it, as a multiple of the standard deviation.

    A few large errors do not blow it up.
    """
    lower, upper = np.quantile(values, (0.25, 0.75))
    spread = min(values.std(), (upper - lower) / 1.34)
    least = _LEAST_BANDWIDTH * (limits[1] - limits[0])
    return float(max(0.9 * spread * len(values) ** -0.2, least) / (values.std(ddof=1) or 1.0))


def _limits(grouped: Sequence[Array]) -> tuple[float, float]:
    """All whiskers and a margin, with zero in the middle, or at the left end of what is never negative."""
    known = [values for values in grouped if len(values)]
    whiskers = [abs(end) for values in known for end in _whiskers(values)]
    reach = _BEYOND_WHISKERS * max(whiskers, default=1.0) or 1.0
    return (-reach if any(values.min() < 0.0 for values in known) else 0.0), reach


def _whiskers(values: Array) -> tuple[float, float]:
    """The last values within 1.5 times the quartiles' distance of them."""
    lower, upper = np.quantile(values, (0.25, 0.75))
    reach = _WHISKER_IQR * (upper - lower)
    return values[values >= lower - reach].min(), values[values <= upper + reach].max()
