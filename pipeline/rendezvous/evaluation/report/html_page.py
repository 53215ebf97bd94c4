"""Pieces of a web page that needs nothing but itself: no script, no file, no network."""

from __future__ import annotations

import base64
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from html import escape

from markupsafe import Markup

from rendezvous.evaluation.report.page import ReportPart


@dataclass(frozen=True, slots=True)
class Html:
    """Markup that is not to be escaped again."""

    text: str


Piece = str | Html
"""Plain words are escaped, markup is not."""

_LEFT = {"name", "words"}
"""Kinds of cells that begin at the left; numbers end at the right."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Cell:
    """A table's cell: what it says, smaller words below, and whether it is the best of its column."""

    main: Piece
    small: Piece = ""
    best: bool = False
    kind: str = "number"


def markup(piece: Piece) -> str:
    """The piece as markup."""
    return piece.text if isinstance(piece, Html) else escape(piece)


def joined(*pieces: Piece) -> Html:
    """Pieces one after the other."""
    return Html("".join(markup(piece) for piece in pieces))


def paragraph(*pieces: Piece, kind: str = "") -> Html:
    """A paragraph."""
    return Html(f"<p{_class(kind)}>{joined(*pieces).text}</p>")


def strong(piece: Piece) -> Html:
    """Words that stand out."""
    return Html(f"<strong>{markup(piece)}</strong>")


def badge(words: str, kind: str) -> Html:
    """A small label; its kind is one of measured, recorded, missing, warning."""
    return Html(f'<span class="badge {kind}">{escape(words)}</span>')


def section(anchor: str, heading: str, *pieces: Piece) -> Html:
    """A section of a part of the page."""
    return Html(f'<section id="{anchor}"><h3>{escape(heading)}</h3>{joined(*pieces).text}</section>')


def subheading(words: str) -> Html:
    """A heading within a section."""
    return Html(f"<h4>{escape(words)}</h4>")


def article(anchor: str, title: str, *pieces: Piece) -> Html:
    """A part of the page."""
    return Html(f'<article id="{anchor}"><h2>{escape(title)}</h2>{joined(*pieces).text}</article>')


def navigation(links: Sequence[tuple[str, str]], *, kind: str = "") -> Html:
    """Links to anchors of this page, each with its words."""
    shown = "".join(f'<a href="#{anchor}">{escape(words)}</a>' for anchor, words in links)
    return Html(f"<nav{_class(kind)}>{shown}</nav>")


def table(header: Sequence[Sequence[tuple[str, int]]], rows: Sequence[Sequence[Cell | None]]) -> Html:
    """A table.

    Args:
        header: lines of words and how many columns they span.
        rows: cells; a None is a rule across the table.
    """
    first = next((row for row in rows if None not in row), ())
    lefts = [cell is not None and not _LEFT.isdisjoint(cell.kind.split()) for cell in first]
    lines = ["<tr>" + "".join(_headings(line, lefts)) + "</tr>" for line in header]
    body = [
        '<tr class="rule">' + f'<td colspan="{sum(span for _, span in header[-1])}"></td></tr>'
        if None in row
        else "<tr>" + "".join(_cell(cell) for cell in row if cell is not None) + "</tr>"
        for row in rows
    ]
    head = f"<thead>{''.join(lines)}</thead>"
    return Html(f'<div class="scroll"><table>{head}<tbody>{"".join(body)}</tbody></table></div>')


def picture(png: bytes, *, alt: str, kind: str = "") -> Html:
    """A picture that is part of the page."""
    data = base64.b64encode(png).decode()
    return Html(f'<img{_class(kind)} alt="{escape(alt)}" src="data:image/png;base64,{data}">')


def figure(png: bytes, *caption: Piece, alt: str) -> Html:
    """A picture with words below."""
    return Html(
        f"<figure>{picture(png, alt=alt).text}<figcaption>{joined(*caption).text}</figcaption></figure>"
    )


def facts(named: Sequence[tuple[str, str]]) -> Html:
    """Short facts, side by side."""
    items = "".join(f"<div><dt>{escape(k)}</dt><dd>{escape(v)}</dd></div>" for k, v in named)
    return Html(f'<dl class="facts">{items}</dl>')


def old_part(
    key: str,
    title: str,
    lead: Html,
    shown_facts: Sequence[tuple[str, str]],
    sections: Sequence[tuple[str, str, Html]],
) -> ReportPart:
    """A part made without a template."""
    links = [(f"{key}-{anchor}", heading) for anchor, heading, _ in sections]
    body = [section(f"{key}-{anchor}", heading, shown) for anchor, heading, shown in sections]
    whole = article(key, title, lead, facts(shown_facts), navigation(links), *body)
    return ReportPart(key=key, title=title, html=Markup(whole.text))


def _headings(line: Sequence[tuple[str, int]], lefts: Sequence[bool]) -> Iterator[str]:
    """One line of a header; over a column of words it begins where they do."""
    column = 0
    for words, span in line:
        kind = "words" if any(lefts[column : column + 1]) else ""
        if span > 1:
            kind = "group" if words else ""
        yield f'<th colspan="{span}"{_class(kind)}>{escape(words)}</th>'
        column += span


def _cell(cell: Cell) -> str:
    kinds = " ".join([cell.kind, *(["best"] if cell.best else [])])
    small = f"<small>{markup(cell.small)}</small>" if cell.small else ""
    return f'<td class="{kinds}">{markup(cell.main)}{small}</td>'


def _class(kind: str) -> str:
    return f' class="{kind}"' if kind else ""
