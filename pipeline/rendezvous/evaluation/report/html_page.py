"""Pieces of a web page that needs nothing but itself: no script, no file, no network."""

from __future__ import annotations

import base64
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from html import escape


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


def page(title: str, *, head: Html, body: Sequence[Html]) -> str:
    """The page.

    Args:
        title: of the window and the first heading.
        head: below the first heading.
        body: the parts.
    """
    return (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>{escape(title)}</title><style>{_CSS}</style></head><body><main>"
        f"<header><h1>{escape(title)}</h1>{head.text}</header>"
        f"{''.join(part.text for part in body)}</main></body></html>\n"
    )


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


_CSS = """
:root{--ink:#26282e;--muted:#767a82;--line:#e5e7eb;--soft:#f6f7f9;--blue:#1c5cbe;--red:#cb2431}
*{box-sizing:border-box}
body{margin:0;background:#fff;color:var(--ink);line-height:1.5;
font:16px/1.5 system-ui,-apple-system,"Segoe UI",Roboto,"Helvetica Neue",Arial,sans-serif}
main{max-width:1400px;margin:0 auto;padding:40px 28px 80px}
h1{font-size:1rem;color:var(--muted);margin:0 0 .5rem}
header>:last-child:not(h1){margin-bottom:2.4rem}
h2{font-size:2.1rem;line-height:1.15;margin:0 0 .4rem;letter-spacing:-.02em}
h3{font-size:1.35rem;margin:3rem 0 .5rem;letter-spacing:-.01em}
h4{font-size:1.02rem;margin:1.8rem 0 .3rem}
article+article{margin-top:5rem;border-top:3px solid var(--ink);padding-top:2.2rem}
p{max-width:76ch;margin:.5rem 0}
p.lead{font-size:1.14rem}
p.note,figcaption{color:var(--muted);font-size:.88rem;max-width:100ch}
nav{display:flex;flex-wrap:wrap;gap:.2rem 1.1rem;margin:1.4rem 0 0;padding:.7rem 0;
border-block:1px solid var(--line);font-size:.9rem}
nav.parts{flex-direction:column;border:0;padding:0;margin:.2rem 0 .8rem;font-size:1rem;font-weight:600}
a{color:var(--blue);text-decoration:none}a:hover{text-decoration:underline}
dl.facts{display:grid;grid-template-columns:repeat(auto-fit,minmax(150px,1fr));gap:1px;margin:1.2rem 0;
background:var(--line);border:1px solid var(--line);border-radius:8px;overflow:hidden}
dl.facts div{background:#fff;padding:.6rem .8rem}
dt{color:var(--muted);font-size:.76rem}dd{margin:0;font-weight:600;font-variant-numeric:tabular-nums}
.scroll{overflow-x:auto;margin:.9rem 0}
table{border-collapse:collapse;width:100%;font-size:.87rem;font-variant-numeric:tabular-nums}
th{font-weight:600;color:var(--muted);text-align:right;padding:.25rem .45rem;font-size:.78rem;
white-space:nowrap;vertical-align:bottom}
th:first-child,th.words,td.name,td.words{text-align:left}
th.group{text-align:center;border-bottom:1px solid var(--line);color:var(--ink)}
td{padding:.36rem .45rem;text-align:right;border-top:1px solid var(--line);vertical-align:top;
white-space:nowrap}
td.words{white-space:normal;min-width:8.5rem}
td.switch{text-align:center;color:var(--muted)}
td.paper{color:var(--muted)}
td.name{font-weight:600}
td.source{white-space:normal;min-width:12rem}
td small{display:block;color:var(--muted);font-size:.72rem;font-weight:400;line-height:1.25}
td.best{font-weight:700;color:var(--blue)}
tr.rule td{padding:0;border-top:2px solid #c9cdd4}
tbody tr:hover td{background:var(--soft)}
.badge{display:inline-block;border-radius:99px;
padding:0 .55em;font-size:.72rem;font-weight:600;line-height:1.6}
.measured{background:#e3f3e6;color:#1f6b32}.recorded{background:#fdf1d8;color:#82580a}
.missing{background:#eef0f3;color:#767a82}.warning{background:#fbe4e4;color:#a11d29}
figure{margin:1.1rem 0}img{max-width:100%;height:auto;display:block}
.gallery{display:grid;
grid-template-columns:repeat(auto-fill,minmax(170px,1fr));gap:12px;margin:.6rem 0 1.4rem}
.images{display:grid;grid-template-columns:repeat(auto-fill,minmax(310px,1fr));gap:14px;margin:.6rem 0 1.4rem}
.images figure{margin:0}
.gallery figure{margin:0}.gallery img{border-radius:6px;border:1px solid var(--line);width:100%}
.gallery figcaption{line-height:1.3;padding-top:.25rem}
.gallery .good{color:#1f6b32}.gallery .bad{color:var(--red)}
code{font-family:ui-monospace,Menlo,Consolas,monospace;font-size:.86em;background:var(--soft);
padding:.08em .3em;border-radius:4px;overflow-wrap:anywhere}
.swatch{display:inline-block;
width:.8em;height:.8em;border-radius:2px;vertical-align:-.05em;margin:0 .25em 0 .6em}
@media print{nav{display:none}main{max-width:none;padding:0}section{break-inside:avoid-page}}
""".strip()
