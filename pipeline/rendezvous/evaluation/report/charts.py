"""The look of the report's charts, and how they become part of the page.

A chart is drawn with matplotlib or seaborn inside `with chart(...)`, and `svg` turns it into inline markup
whose ink follows the page's light or dark colours.
"""

from __future__ import annotations

import hashlib
import io
import re
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from rendezvous.errors import needs_extra
from rendezvous.evaluation.pictures.canvas import Colour

with needs_extra("learn", "the report"):
    import matplotlib as mpl
    from markupsafe import Markup
    from matplotlib.axis import Axis
    from matplotlib.figure import Figure
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

_WIDTH_IN = 10.0
INK, MUTED, LINE = "#26282e", "#767a82", "#e5e7eb"
"""Text and medians, ticks and reference lines, the grid: the page gives each its colour in light and dark."""
_VARIABLES = {INK: "var(--ink)", MUTED: "var(--muted)", LINE: "var(--line)", "#1c5cbe": "var(--blue)"}
_STYLE: dict[Any, Any] = {
    "font.family": "DejaVu Sans",
    "font.size": 9.5,
    "text.color": INK,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.edgecolor": MUTED,
    "axes.labelcolor": INK,
    "axes.facecolor": "none",
    "axes.titlesize": 10.5,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "figure.facecolor": "none",
    "xtick.color": MUTED,
    "ytick.color": MUTED,
    "grid.color": LINE,
    "axes.grid": True,
    "axes.axisbelow": True,
    "legend.frameon": False,
    "savefig.dpi": 170,
    "svg.fonttype": "none",
    "svg.hashsalt": "report",
}


@contextmanager
def chart(height_in: float) -> Iterator[Figure]:
    """A figure as wide as the report, in its style; draw it and call `svg` inside."""
    with mpl.rc_context(_STYLE):
        yield Figure(figsize=(_WIDTH_IN, height_in), layout="constrained")


def svg(figure: Figure) -> Markup:
    """The figure as inline SVG; the same numbers give the same bytes."""
    sink = io.StringIO()
    figure.savefig(sink, format="svg", metadata=dict.fromkeys(("Creator", "Date", "Format", "Type")))
    text = sink.getvalue()
    text = text[text.index("<svg") :]
    text = re.sub(r' (width|height)="[\d.]+pt"| xmlns(:\w+)?="[^"]*"| version="[\d.]+"', "", text, count=5)
    # Only what is referred to keeps its id, made unique among the charts of a page.
    used = {name for pair in re.findall(r'href="#([^"]+)"|url\(#([^)]+)\)', text) for name in pair}
    text = re.sub(r' id="([^"]+)"', lambda found: found[0] if found[1] in used else "", text)
    prefix = "c" + hashlib.sha256(text.encode()).hexdigest()[:8]
    text = re.sub(r'( id="|href="#|url\(#)', rf"\g<1>{prefix}-", text)
    for colour, variable in _VARIABLES.items():
        text = text.replace(colour, variable)
    return Markup(re.sub(r">\s+<", "><", text).strip())


def plain_numbers(axis: Axis, *, digits: tuple[float, ...] = (1.0,)) -> None:
    """Ticks of a logarithmic axis at powers of ten times some digits, written as 0.01 and not as 10⁻²."""
    axis.set_major_locator(LogLocator(subs=digits))
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:,g}"))
    axis.set_minor_formatter(NullFormatter())


def rgb(colour: Colour) -> tuple[float, float, float]:
    """A colour as matplotlib takes it."""
    red, green, blue = colour
    return red / 255.0, green / 255.0, blue / 255.0
