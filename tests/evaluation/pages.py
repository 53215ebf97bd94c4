"""What every page of the report must be."""

from __future__ import annotations

import re
from html.parser import HTMLParser

VOID = ("meta", "br", "img")


class PageReader(HTMLParser):
    """Sees that every tag is closed in its turn, and notes what the page refers to."""

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.seen: list[str] = []
        self.references: list[str] = []
        self.anchors: list[str] = []

    def handle_starttag(self, tag, attrs) -> None:
        self.seen.append(tag)
        self.references += [value for key, value in attrs if key in ("src", "href")]
        self.anchors += [value for key, value in attrs if key == "id"]
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag) -> None:
        assert self.open.pop() == tag


def require_self_contained(page: str) -> set[str]:
    """See that a page is whole and refers to nothing but itself; returns its anchors."""
    reader = PageReader()
    reader.feed(page)
    assert not reader.open
    assert not {"script", "link", "iframe", "object"} & set(reader.seen)
    assert all(r.startswith(("data:image/png;base64,", "#")) for r in reader.references)
    assert not re.search(r"https?:|@import|url\((?!#)", page)
    assert len(set(reader.anchors)) == len(reader.anchors)
    assert {r[1:] for r in reader.references if r.startswith("#")} <= set(reader.anchors)
    return set(reader.anchors)
