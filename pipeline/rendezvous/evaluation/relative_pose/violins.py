"""Box plots over violin plots of signed or absolute errors by group, as the paper's Fig. 5 shows them.

Groups lie below each other and components side by side, so that names of groups have room and stand once.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from rendezvous.evaluation.pictures.canvas import BLUE, INK, MUTED, PAPER, Colour
from rendezvous.evaluation.report.charts import chart, png, rgb
from rendezvous.geometry.se2 import Array

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_HEADER_IN, _GROUP_IN = 1.0, 0.62
_LEAST_VIOLIN = 10
"""A density of fewer values would show what is not known: they are drawn as dots."""
_HALF_VIOLIN, _HALF_BOX = 0.36, 0.09
_DENSITY_POINTS = 201
_LEAST_BANDWIDTH = 0.004
"""As a share of the axis, so that equal values have a density as well."""
_WHISKER_IQR = 1.5
_BEYOND_WHISKERS = 1.25
_WORDS: dict[str, Any] = {"size": 7.5, "color": rgb(MUTED)}


@dataclass(frozen=True, slots=True, kw_only=True)
class Component:
    """One component of the errors, a panel of the chart.

    Attributes:
        name: e.g. Δx.
        unit: of its values, e.g. m or °.
        axis: the values between which it is drawn; None for all whiskers and a margin, zero in the middle
            of what has signs.
        label: below the axis; by default that these are errors, and their unit.
    """

    name: str
    unit: str
    axis: tuple[float, float] | None = None
    label: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class Box:
    """Tukey's box plot of some values: whiskers end at the last value within 1.5 times the box's length.

    Attributes:
        low, high: ends of the whiskers.
        lower, median, upper: quartiles.
    """

    low: float
    lower: float
    median: float
    upper: float
    high: float

    @staticmethod
    def of(values: Array) -> Box:
        """Of at least one value (N,)."""
        lower, median, upper = (float(q) for q in np.quantile(values, (0.25, 0.5, 0.75)))
        reach = _WHISKER_IQR * (upper - lower)
        inside = values[(values >= lower - reach) & (values <= upper + reach)]
        return Box(
            low=float(inside.min(initial=lower)),
            lower=lower,
            median=median,
            upper=upper,
            high=float(inside.max(initial=upper)),
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class _Group:
    """Errors (N, C) of a group that has estimates, and how many it has without."""

    name: str
    errors: Array
    missing: int
    colour: Colour

    @property
    def label(self) -> str:
        asked = f" of {len(self.errors) + self.missing:,}" if self.missing else ""
        return f"{self.name}\nn = {len(self.errors):,}{asked}"


def violin_chart(
    groups: Mapping[str, Array],
    components: Sequence[Component],
    *,
    colours: Mapping[str, Colour] | None = None,
) -> bytes:
    """Errors by group: violins, boxes with median, quartiles and whiskers, and dots beyond those.

    A row with a NaN is an estimate that was not made: below a group's name stands `n = ` made `of` asked for.
    The share of what lies beyond the axis is told.

    Args:
        groups: errors (N, C) by name, a column for each component in its unit, finite or NaN, from the top
            down.
        components: C of them, from the left.
        colours: of groups; blue where none is given.

    Returns:
        A PNG.
    """
    with chart(_HEADER_IN + _GROUP_IN * len(groups)) as figure:
        draw_violins(figure, groups, components, colours=colours)
        return png(figure)


def draw_violins(
    figure: Figure,
    groups: Mapping[str, Array],
    components: Sequence[Component],
    *,
    colours: Mapping[str, Colour] | None = None,
) -> Sequence[Axes]:
    """Draw what `violin_chart` shows on a figure; returns a panel for each component."""
    told = [_group(name, errors, (colours or {}).get(name, BLUE)) for name, errors in groups.items()]
    panels = figure.subplots(1, len(components), sharey=True, squeeze=False).ravel()
    for column, (panel, component) in enumerate(zip(panels, components, strict=True)):
        values = [group.errors[:, column] for group in told]
        limits = component.axis or _limits(values)
        for row, (group, errors) in enumerate(zip(told, values, strict=True)):
            _draw_group(panel, row, errors, limits, group.colour)
        panel.axvline(0.0, color=rgb(MUTED), lw=0.8)
        panel.locator_params(axis="x", nbins=5)  # more run into each other
        panel.set(xlim=limits, title=component.name, xlabel=component.label or f"error [{component.unit}]")
        panel.grid(visible=False, axis="y")
    panels[0].set_yticks(range(len(told)), [group.label for group in told], color=rgb(INK))
    panels[0].set_ylim(len(told) - 0.5, -0.5)
    return list(panels)


def _group(name: str, errors: Array, colour: Colour) -> _Group:
    made = ~np.isnan(errors).any(axis=1)
    return _Group(name=name, errors=errors[made], missing=int((~made).sum()), colour=colour)


def _limits(values: Sequence[Array]) -> tuple[float, float]:
    """All whiskers and a margin, with zero in the middle or at the left end."""
    known = [each for each in values if len(each)]
    boxes = [Box.of(each) for each in known]
    reach = _BEYOND_WHISKERS * max((max(-box.low, box.high) for box in boxes), default=1.0) or 1.0
    return (-reach if any(each.min() < 0.0 for each in known) else 0.0), reach


def _draw_group(panel: Axes, row: int, errors: Array, limits: tuple[float, float], colour: Colour) -> None:
    if not len(errors):
        panel.annotate("none", (1.0, row), xycoords=("axes fraction", "data"), ha="right", **_WORDS)
        return
    box = Box.of(errors)
    inside = (errors >= limits[0]) & (errors <= limits[1])
    shown = errors[inside]
    if len(shown) >= _LEAST_VIOLIN:
        x, half = _outline(shown, limits)
        panel.fill_between(x, row - half, row + half, color=rgb(colour), alpha=0.3, lw=0.0)
        _draw_dots(panel, row, shown[(shown < box.low) | (shown > box.high)], colour)
    else:
        _draw_dots(panel, row + 2.5 * _HALF_BOX, shown, colour)
    _draw_box(panel, row, box)
    if not inside.all():
        beyond = f"{100.0 * (1.0 - inside.mean()):.1f} % beyond"
        panel.annotate(beyond, (1.0, row - 0.3), xycoords=("axes fraction", "data"), ha="right", **_WORDS)


def _outline(values: Array, limits: tuple[float, float]) -> tuple[Array, Array]:
    """Where a violin is drawn and half its thickness there, by a kernel density of the values shown.

    The bandwidth is Silverman's (1986, Eq. 3.31), which a few large errors do not blow up.
    """
    lower, upper = np.quantile(values, (0.25, 0.75))
    spread = min(float(values.std()), float(upper - lower) / 1.34)
    bandwidth = max(0.9 * spread * len(values) ** -0.2, _LEAST_BANDWIDTH * (limits[1] - limits[0]))
    # Where values end at zero, as distances do, the violin ends with them.
    x = np.linspace(values.min(), values.max(), _DENSITY_POINTS)
    density = np.exp(-0.5 * ((x[:, None] - values[None, :]) / bandwidth) ** 2).sum(axis=1)
    return x, _HALF_VIOLIN * density / density.max()


def _draw_dots(panel: Axes, height: float, values: Array, colour: Colour) -> None:
    panel.plot(values, np.full(len(values), height), "o", ms=2.5, mew=0, color=rgb(colour), alpha=0.6)


def _draw_box(panel: Axes, row: int, box: Box) -> None:
    panel.hlines(row, box.low, box.high, color=rgb(INK), lw=1.0)
    corners = [box.lower, box.upper, box.upper, box.lower]
    sides = [row - _HALF_BOX, row - _HALF_BOX, row + _HALF_BOX, row + _HALF_BOX]
    panel.fill(corners, sides, facecolor=rgb(PAPER), edgecolor=rgb(INK), lw=1.0, zorder=3)
    reach = 1.8 * _HALF_BOX
    panel.vlines(box.median, row - reach, row + reach, color=rgb(INK), lw=2.2, zorder=4)
