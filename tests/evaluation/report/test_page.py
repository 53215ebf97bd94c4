from __future__ import annotations

import json
from dataclasses import replace

import pytest
from rendezvous.errors import StoreError
from rendezvous.evaluation.report.html_page import Html, paragraph
from rendezvous.evaluation.report.page import PARTS, ReportPart, ReportSection, report_page

from tests.evaluation.pages import require_self_contained


def _part(key: str) -> ReportPart:
    sections = [
        ReportSection(anchor=name, heading=f"{key}: {name}", body=paragraph(f"body of {key}"))
        for name in ("table", "gallery")
    ]
    return ReportPart(
        key=key,
        title=f"Title of {key} <here>",
        lead=paragraph(f"lead of {key}"),
        facts=(("pairs", f"{key}: 7"),),
        sections=tuple(sections),
    )


def test_parts_come_in_the_order_of_the_page_whenever_they_were_made():
    page = report_page([_part(key) for key in reversed(PARTS)])
    assert PARTS == ("relative_pose", "frame_error", "fusion")
    for words in ("Title of {} &lt;here&gt;</h2>", "lead of {}", "{}: 7", "body of {}"):
        places = [page.index(words.format(key)) for key in PARTS]
        assert places == sorted(places)


def test_parts_with_sections_of_the_same_name_have_anchors_of_their_own():
    anchors = require_self_contained(report_page([_part("fusion"), _part("frame_error")]))
    sections = {f"{key}-{name}" for key in ("fusion", "frame_error") for name in ("table", "gallery")}
    assert anchors == {"fusion", "frame_error"} | sections


def test_several_parts_are_linked_from_the_head_and_one_alone_is_not():
    both = report_page([_part("fusion"), _part("frame_error")])
    assert all(f'href="#{key}"' in both for key in ("fusion", "frame_error"))
    alone = report_page([_part("fusion")])
    assert 'href="#fusion"' not in alone
    assert 'href="#fusion-table"' in alone
    assert "<h1>Rendezvous: report</h1>" in alone


def test_an_evaluation_whose_part_cannot_be_shown_is_named():
    page = report_page([_part("fusion")], absent=["frame_error"])
    assert "The evaluation “frame_error” was made, and its part of this page is missing or damaged" in page
    assert "not shown" not in report_page([_part("fusion")])


def test_a_part_survives_json():
    part = _part("fusion")
    values = json.loads(json.dumps(part.to_json()))
    assert ReportPart.from_json(values, key="fusion", where="here") == part


@pytest.mark.parametrize(
    ("damage", "said"),
    [
        ({"format": 0}, "here: a part of the report of format 0; must be 1"),
        ({"title": None}, "here: no part of the report (None is not text)"),
        ({"facts": [["pairs"]]}, "here: no part of the report (not enough values"),
        ({"sections": [["a", "b", 3]]}, "here: no part of the report (3 is not text)"),
        ({"sections": 3}, "here: no part of the report ("),
    ],
)
def test_a_damaged_or_old_part_is_told(damage, said):
    with pytest.raises(StoreError) as raised:
        ReportPart.from_json({**_part("fusion").to_json(), **damage}, key="fusion", where="here")
    assert str(raised.value).startswith(said)
    with pytest.raises(StoreError, match=r"no part of the report \('format'\)"):
        ReportPart.from_json({}, key="fusion", where="here")


def test_two_sections_of_one_name_are_refused():
    part = _part("fusion")
    again = replace(part.sections[0], body=Html(""))
    with pytest.raises(StoreError, match=r"fusion: more than one section named table; names are unique"):
        replace(part, sections=(*part.sections, again))
