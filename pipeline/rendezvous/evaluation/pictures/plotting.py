"""What the report's charts have in common: their looks, and how they become PNGs."""

from __future__ import annotations

import io
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from rendezvous.errors import needs_extra
from rendezvous.evaluation.pictures.canvas import Colour

with needs_extra("learn", "the report"):
    import matplotlib as mpl
    from matplotlib.axis import Axis
    from matplotlib.figure import Figure
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

_WIDTH_IN = 10.0
_STYLE: dict[Any, Any] = {
    "font.family": "DejaVu Sans",
    "font.size": 9.5,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.edgecolor": "#8a8e96",
    "axes.labelcolor": "#26282e",
    "axes.titlesize": 10.5,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "xtick.color": "#767a82",
    "ytick.color": "#767a82",
    "grid.color": "#e5e7eb",
    "axes.grid": True,
    "axes.axisbelow": True,
    "legend.frameon": False,
    "savefig.dpi": 170,
}


@contextmanager
def chart(height_in: float) -> Iterator[Figure]:
    """A figure of the report's width; its looks hold for what is drawn, and encoded, inside."""
    with mpl.rc_context(_STYLE):
        yield Figure(figsize=(_WIDTH_IN, height_in), layout="constrained")


def png(figure: Figure) -> bytes:
    """The figure as a PNG."""
    sink = io.BytesIO()
    # Without the version that matplotlib would write, the same numbers give the same bytes.
    figure.savefig(sink, format="png", metadata={"Software": None})
    return sink.getvalue()


def plain_numbers(axis: Axis, *, digits: tuple[float, ...] = (1.0,)) -> None:
    """Ticks of a logarithmic axis at powers of ten times some digits, written as 0.01 and not as 10⁻²."""
    axis.set_major_locator(LogLocator(subs=digits))
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:,g}"))
    axis.set_minor_formatter(NullFormatter())


def rgb(colour: Colour) -> tuple[float, float, float]:
    """A colour as matplotlib takes it."""
    red, green, blue = colour
    return red / 255.0, green / 255.0, blue / 255.0
