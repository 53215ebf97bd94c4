"""The report: one page made of parts, each from its own evaluation and its own Jinja2 template.

A part's template `templates/KEY.html.j2` extends `part.html.j2` and takes tables, figures and number formats
from `macros.html.j2`; `render_part` fills it in.
"""

from __future__ import annotations

import base64
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

from rendezvous.errors import StoreError, needs_extra
from rendezvous.evaluation.pictures.canvas import encoded_png
from rendezvous.evaluation.statistics import Interval
from rendezvous.geometry.camera import Image

with needs_extra("learn", "the report"):
    from jinja2 import Environment, PackageLoader, StrictUndefined
    from markupsafe import Markup

PARTS = ("relative_pose", "frame_error", "fusion")
"""Keys of the evaluations, in the order of the page."""

_FORMAT = 2
_DASH = "–"


@dataclass(frozen=True, slots=True, kw_only=True)
class ReportPart:
    """One evaluation's part of the page."""

    key: str  # one of `PARTS`; also the evaluation's key in `metrics.json`
    title: str  # plain text
    html: Markup  # the whole part; its sections' anchors begin with the key

    def to_json(self) -> dict[str, Any]:
        """JSON values, without the key, which is the file's name."""
        return {"format": _FORMAT, "title": self.title, "html": str(self.html)}

    @staticmethod
    def from_json(values: Mapping[str, Any], *, key: str, where: str) -> ReportPart:
        """Inverse of `to_json`.

        Raises:
            StoreError: `values` is not a part in this format.
        """
        if values.get("format") != _FORMAT:
            raise StoreError(
                f"{where}: a part of the report of format {values.get('format')}; must be {_FORMAT}"
            )
        title, html = values.get("title"), values.get("html")
        if not isinstance(title, str) or not isinstance(html, str):
            raise StoreError(f"{where}: not a part of the report; title and html must be text")
        return ReportPart(key=key, title=title, html=Markup(html))


def render_part(key: str, *, title: str, facts: Sequence[tuple[str, str]], **context: Any) -> ReportPart:
    """Fill in the template of a part.

    Args:
        key: one of `PARTS`; the template is `KEY.html.j2`.
        title: plain text.
        facts: names and values shown beside each other at the top.
        context: further names for the template.
    """
    links: list[tuple[str, str]] = []
    template = _environment().get_template(f"{key}.html.j2")
    html = template.render(key=key, title=title, facts=facts, links=links, **context)
    anchors = [anchor for anchor, _ in links]
    assert len(set(anchors)) == len(anchors), f"{key}: two sections with the same anchor among {anchors}"
    return ReportPart(key=key, title=title, html=Markup(html))


def report_page(parts: Sequence[ReportPart], *, absent: Sequence[str] = ()) -> str:
    """The page of all parts.

    Args:
        parts: in any order.
        absent: keys of evaluations that were made but whose parts cannot be shown.
    """
    ordered = sorted(parts, key=lambda part: PARTS.index(part.key))
    return _environment().get_template("page.html.j2").render(parts=ordered, absent=absent)


def percent(value: float | None, decimals: int = 1) -> str:
    """A share in percent, or a dash for None and NaN."""
    return _DASH if value is None or math.isnan(value) else f"{100.0 * value:.{decimals}f} %"


def number(value: float | None, decimals: int = 0, *, scale: float = 1.0, signed: bool = False) -> str:
    """A number with a true minus sign; a dash for None and NaN, ∞ for infinity."""
    if value is None or math.isnan(value):
        return _DASH
    if math.isinf(value):
        return "∞" if value > 0.0 else "−∞"
    return f"{scale * value:{'+' if signed else ''}.{decimals}f}".replace("-", "−")


def bounds(value: Interval, decimals: int = 0, *, scale: float = 1.0) -> str:
    """The ends of an interval, or '' where there is nothing to measure."""
    if math.isnan(value.low):
        return ""
    return f"{number(value.low, decimals, scale=scale)} … {number(value.high, decimals, scale=scale)}"


def data_uri(picture: bytes | Image) -> str:
    """A PNG, or the pixels of one, as a `data:` address."""
    data = picture if isinstance(picture, bytes) else encoded_png(picture)
    return f"data:image/png;base64,{base64.b64encode(data).decode()}"


@cache
def _environment() -> Environment:
    environment = Environment(
        loader=PackageLoader("rendezvous.evaluation.report", "templates"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        extensions=["jinja2.ext.do"],
    )
    environment.filters |= {
        "percent": percent,
        "number": number,
        "bounds": bounds,
        "degrees": math.degrees,
        "data_uri": data_uri,
    }
    return environment
