from __future__ import annotations

import json
import math

import pytest
from jinja2 import ChoiceLoader, DictLoader

from rendezvous.errors import StoreError
from rendezvous.evaluation.report import page
from rendezvous.evaluation.report.page import PARTS, ReportPart, render_part, report_page
from rendezvous.evaluation.statistics import NOTHING, Interval
from tests.evaluation.pages import require_self_contained

TEMPLATE = """
{% extends "part.html.j2" %}
{% from "macros.html.j2" import section with context %}
{% block lead %}<p>lead of {{ key }}</p>{% endblock %}
{% block sections %}{% for name in names %}{% call section(name, name) %}body of {{ key }}{% endcall %}
{% endfor %}{% endblock %}
"""


def _part(key: str, names: tuple[str, ...] = ("table", "gallery")) -> ReportPart:
    title = f"Title of {key} <here>"
    return render_part(key, title=title, facts=[("pairs", f"{key}: 7")], names=names)


@pytest.fixture(autouse=True)
def toy_templates(monkeypatch):
    """Every part is made from one short template."""
    environment = page._environment()
    toys = DictLoader({f"{key}.html.j2": TEMPLATE for key in PARTS})
    monkeypatch.setattr(environment, "loader", ChoiceLoader([toys, environment.loader]))
    environment.cache.clear()
    yield
    environment.cache.clear()


def test_parts_come_in_the_order_of_the_page_whenever_they_were_made():
    html = report_page([_part(key) for key in reversed(PARTS)])
    assert PARTS == ("relative_pose", "frame_error", "fusion")
    for words in ("Title of {} &lt;here&gt;</h2>", "lead of {}", "{}: 7", "body of {}"):
        places = [html.index(words.format(key)) for key in PARTS]
        assert places == sorted(places)


def test_several_parts_have_anchors_of_their_own_and_are_linked_from_the_head_unlike_one_alone():
    both, alone = report_page([_part("fusion"), _part("frame_error")]), report_page([_part("fusion")])
    sections = {f"{key}-{name}" for key in ("fusion", "frame_error") for name in ("table", "gallery")}
    assert require_self_contained(both) == {"fusion", "frame_error"} | sections
    assert all(f'href="#{key}"' in both for key in ("fusion", "frame_error"))
    assert 'href="#fusion"' not in alone
    assert 'href="#fusion-table"' in alone


def test_an_evaluation_whose_part_cannot_be_shown_is_named():
    said = "The evaluation “frame_error” was made, and its part of this page is missing or damaged"
    assert said in report_page([_part("fusion")], absent=["frame_error"])
    assert "was made" not in report_page([_part("fusion")])


def test_a_part_survives_json():
    part = _part("fusion")
    values = json.loads(json.dumps(part.to_json()))
    assert ReportPart.from_json(values, key="fusion", where="here") == part


@pytest.mark.parametrize(
    ("damage", "said"),
    [
        ({"format": 1}, "a part of the report of format 1; must be 2"),
        ({"title": None}, "not a part of the report; title and html must be text"),
        ({"html": 3}, "not a part of the report; title and html must be text"),
    ],
)
def test_a_damaged_or_old_part_is_refused(damage, said):
    with pytest.raises(StoreError, match=f"here: {said}"):
        ReportPart.from_json({**_part("fusion").to_json(), **damage}, key="fusion", where="here")


def test_two_sections_of_one_name_are_refused():
    with pytest.raises(AssertionError, match="two sections with the same anchor"):
        _part("fusion", ("table", "table"))


def test_numbers_are_written_with_a_true_minus_and_what_is_missing_as_a_dash():
    assert page.number(-0.1234, 2, scale=10.0) == "−1.23"
    assert page.number(1.5, 1, signed=True) == "+1.5"
    assert [page.number(value, 1) for value in (math.nan, None, math.inf, -math.inf)] == ["–", "–", "∞", "−∞"]
    assert [page.percent(value) for value in (0.1234, 1.0, math.nan, None)] == ["12.3 %", "100.0 %", "–", "–"]
    assert page.bounds(Interval(value=0.5, low=-0.25, high=0.75), 0, scale=100.0) == "−25 … 75"
    assert page.bounds(NOTHING) == ""
