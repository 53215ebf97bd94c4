"""The report: one page of the parts that evaluations left, each made at a time of its own."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from rendezvous.errors import StoreError
from rendezvous.evaluation.report.html_page import (
    Html,
    article,
    badge,
    facts,
    joined,
    navigation,
    page,
    paragraph,
    section,
)

PARTS = ("relative_pose", "frame_error", "fusion")
"""What can be evaluated, in the order of the page."""

_FORMAT = 1


@dataclass(frozen=True, slots=True, kw_only=True)
class ReportSection:
    """A section of a part.

    Attributes:
        anchor: what a link to it ends in; unique in its part.
        heading: plain words.
        body: what it shows.
    """

    anchor: str
    heading: str
    body: Html


@dataclass(frozen=True, slots=True, kw_only=True)
class ReportPart:
    """What one evaluation tells on the page.

    Attributes:
        key: of `PARTS`; its figures have it in `metrics.json`.
        title: plain words.
        lead: the result, below the title.
        facts: names and values of what it was measured on.
        sections: in order.
    """

    key: str
    title: str
    lead: Html
    facts: tuple[tuple[str, str], ...]
    sections: tuple[ReportSection, ...]

    def __post_init__(self) -> None:
        anchors = [section.anchor for section in self.sections]
        twice = sorted({anchor for anchor in anchors if anchors.count(anchor) > 1})
        if twice:
            raise StoreError(f"{self.key}: more than one section named {', '.join(twice)}; names are unique")

    @property
    def html(self) -> Html:
        """The part with links to its sections, whose anchors begin with its key."""
        named = [(f"{self.key}-{section.anchor}", section) for section in self.sections]
        return article(
            self.key,
            self.title,
            self.lead,
            facts(self.facts),
            navigation([(anchor, shown.heading) for anchor, shown in named]),
            *(section(anchor, shown.heading, shown.body) for anchor, shown in named),
        )

    def to_json(self) -> dict[str, Any]:
        """Values as JSON holds them; the key is left to the file's name."""
        return {
            "format": _FORMAT,
            "title": self.title,
            "lead": self.lead.text,
            "facts": [list(fact) for fact in self.facts],
            "sections": [[shown.anchor, shown.heading, shown.body.text] for shown in self.sections],
        }

    @staticmethod
    def from_json(values: Mapping[str, Any], *, key: str, where: str) -> ReportPart:
        """Inverse of `to_json`.

        Raises:
            StoreError: these are not the values of a part.
        """
        try:
            if values["format"] != _FORMAT:
                raise StoreError(
                    f"{where}: a part of the report of format {values['format']}; must be {_FORMAT}"
                )
            return ReportPart(
                key=key,
                title=_words(values["title"]),
                lead=Html(_words(values["lead"])),
                facts=tuple((_words(name), _words(value)) for name, value in values["facts"]),
                sections=tuple(
                    ReportSection(anchor=_words(anchor), heading=_words(heading), body=Html(_words(body)))
                    for anchor, heading, body in values["sections"]
                ),
            )
        except (KeyError, TypeError, ValueError) as error:
            raise StoreError(f"{where}: no part of the report ({error})") from error


def report_page(parts: Sequence[ReportPart], *, absent: Sequence[str] = ()) -> str:
    """The page of all parts.

    Args:
        parts: in any order.
        absent: keys of evaluations that were made and whose parts cannot be shown.
    """
    ordered = sorted(parts, key=lambda part: PARTS.index(part.key))
    links = navigation([(part.key, part.title) for part in ordered], kind="parts")
    return page(
        "Rendezvous: report",
        # One part alone has its title right below.
        head=joined(links if len(ordered) > 1 else "", *(_absence(key) for key in absent)),
        body=[part.html for part in ordered],
    )


def _absence(key: str) -> Html:
    return paragraph(
        badge("not shown", "warning"),
        f" The evaluation “{key}” was made, and its part of this page is missing or damaged; run it again.",
    )


def _words(value: Any) -> str:
    if not isinstance(value, str):
        raise TypeError(f"{value!r} is not text")
    return value
