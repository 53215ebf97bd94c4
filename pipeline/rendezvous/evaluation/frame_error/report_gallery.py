"""Pictures in the report on frame-error estimators: pairs under each method, and attention."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from rendezvous.evaluation.frame_error.estimates import SUCCESS_M, SUCCESS_RAD
from rendezvous.evaluation.frame_error.gallery import Panel
from rendezvous.evaluation.frame_error.table_one import METHODS, title
from rendezvous.evaluation.pictures.canvas import encoded_png
from rendezvous.evaluation.report.html_page import Html, Piece, joined, paragraph, picture, strong, subheading


@dataclass(frozen=True, slots=True, kw_only=True)
class Shown:
    """One pair of the gallery: why it is shown, its overlap, and its pictures."""

    pair_id: str
    why: str
    overlap: float
    panels: tuple[Panel, ...]


def gallery_section(gallery: Sequence[Shown], *, reference: str) -> list[Html]:
    """Pairs as each method puts them; they were chosen by the errors of one method, `reference`."""
    return [
        paragraph(
            f"The paper's Fig. 6b: best, median and worst pair of “{title(reference)}”, and its median among "
            "the tenth of pairs with the least overlap. Red: map 0. Blue: map 1 where the transform puts it. "
            "Violet: walls of both. The black robot is where robot 1 stands, the blue one where it is put."
        ),
        *(_shown(shown) for shown in gallery),
    ]


def _shown(shown: Shown) -> Html:
    pictures = "".join(_panel(panel).text for panel in shown.panels)
    return joined(
        subheading(shown.why.capitalize()),
        paragraph(f"{shown.pair_id}, overlap {shown.overlap:.2f}", kind="note"),
        Html(f'<div class="gallery">{pictures}</div>'),
    )


def _panel(panel: Panel) -> Html:
    name = title(panel.name) if panel.name in METHODS else panel.name.capitalize()
    words: Piece = ""
    if panel.position_m is not None and panel.heading_rad is not None:
        good = panel.position_m <= SUCCESS_M and panel.heading_rad <= SUCCESS_RAD and not panel.failed
        kind = "" if panel.name == "input" else ' class="good"' if good else ' class="bad"'
        error = f"{panel.position_m:.2f} m, {math.degrees(panel.heading_rad):.1f}°"
        words = Html(f"<span{kind}>{'no estimate, ' if panel.failed else ''}{error}</span>")
    caption = joined(strong(name), Html("<br>") if words else "", words)
    image = picture(encoded_png(panel.image), alt=name)
    return Html(f"<figure>{image.text}<figcaption>{caption.text}</figcaption></figure>")


def attention_section(attention: Mapping[str, Sequence[Panel]]) -> list[Html]:
    """What networks look at, by method; empty without one that attends."""
    out = []
    for name, panels in attention.items():
        pictures = "".join(_panel(panel).text for panel in panels)
        out.append(joined(subheading(title(name)), Html(f'<div class="gallery">{pictures}</div>')))
    if out:
        note = (
            "Attention Rollout (Abnar & Zuidema, 2020) of the class token over the window, in the window's "
            "own axes, for the pairs of the gallery. Orange: more than an even share, at full strength four "
            "times as much."
        )
        out.append(paragraph(note, kind="note"))
    return out
