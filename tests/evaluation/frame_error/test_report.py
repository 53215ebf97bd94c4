from __future__ import annotations

import json
import re
from contextlib import nullcontext
from dataclasses import replace
from functools import partial
from unittest.mock import patch

import numpy as np
import pandas as pd
import pytest

pytest.importorskip("matplotlib")

from rendezvous.errors import StoreError
from rendezvous.evaluation.frame_error import report
from rendezvous.evaluation.frame_error.charts import calibration_chart, curve_chart
from rendezvous.evaluation.frame_error.estimates import outcome_table
from rendezvous.evaluation.frame_error.gallery import Shown, panels
from rendezvous.evaluation.frame_error.measured_row import MeasuredRow, PairConditions
from rendezvous.evaluation.frame_error.report import FrameErrorContent, frame_error_part
from rendezvous.evaluation.frame_error.summary import Comparison, comparisons, summary
from rendezvous.evaluation.frame_error.symmetry import Symmetry
from rendezvous.evaluation.frame_error.training_curve import Training, TrainingCurve
from rendezvous.evaluation.report.page import report_page
from rendezvous.evaluation.report.recorded_figures import read_recorded
from rendezvous.evaluation.statistics import Interval, resample_weights
from rendezvous.geometry.se2 import SE2
from rendezvous.methods import METHODS
from tests.evaluation.pages import require_self_contained
from tests.evaluation.toy_pairs import tables_of, toy_outcomes, toy_pair, toy_sample

CONDITIONS = PairConditions(
    split="test",
    pairs=3,
    plans=3,
    data_digest="d" * 64,
    perturbation_digest="p" * 64,
    seed=0,
    xy_range_m=2.0,
    yaw_range_deg=45.0,
    commit="c" * 40,
    hardware="2 cores of <nothing>",
)
FALLING = TrainingCurve(
    samples=np.arange(1.0, 21.0), position_m=1.0 / np.arange(1.0, 21.0), yaw_rad=np.ones(20), minutes=8.0
)
SHARES = ("table-1", "overlap", "calibration")
"""Sections with shares, whose intervals take pairs as independent."""
NO_CHARTS = dict.fromkeys(("scatter", "cdf", "calibration", "curves"))
TRAINING = Training(
    seed=4,
    samples=12345,
    minutes=8.0,
    data="data/dataset",
    pairs=9,
    plans=3,
    weights_digest="w",
    curve=FALLING,
)


def _page(content: FrameErrorContent, *, drawn: bool = False) -> str:
    """The page, by default without its charts, which take seconds to draw."""
    with nullcontext() if drawn else patch.object(report, "_charts", return_value=NO_CHARTS):
        return report_page([frame_error_part(content)])


@pytest.fixture(scope="module")
def content() -> FrameErrorContent:
    toys = [toy_pair(plan) for plan in (3, 4, 5)]
    weights = resample_weights(np.arange(3), rng=np.random.default_rng(0))
    found = {
        "orb": toy_outcomes(toys, off=SE2(0.4, 0.0, 0.0), failing=True),
        "correlative": toy_outcomes(toys, off=SE2(0.05, 0.0, 0.0)),
        "vit-lie": toy_outcomes(toys, off=SE2(0.1, 0.0, 0.0)),
    }
    outcomes = outcome_table(found, np.array([pair.overlap for pair in toys]))
    rows = {
        name: MeasuredRow(
            method=name,
            conditions=CONDITIONS,
            summary=summary(group, weights),
            training=TRAINING if name == "vit-lie" else None,
        )
        for name, group in outcomes.groupby("method", sort=False)
    }
    outcomes = outcomes[outcomes["method"] != "vit-lie"]
    shown = panels(toys[0], toy_sample(toys[0]), outcomes.loc[[0]])
    return FrameErrorContent(
        conditions=CONDITIONS,
        methods=METHODS,
        outcomes=outcomes,
        rows=rows,
        symmetry=None,
        comparisons=comparisons(outcomes, weights),
        gallery=[Shown(pair_id=toys[0].pair_id, why="best", overlap=0.5, panels=tuple(shown))],
        attention={"vit-lie": shown[:1]},
        dataset="data/dataset",
        versions={"numpy": "1"},
    )


@pytest.fixture(scope="module")
def page(content) -> str:
    return _page(content, drawn=True)


def test_the_page_needs_nothing_but_itself_and_escapes_words_from_outside(page):
    assert "frame_error-table-1" in require_self_contained(page)
    assert "2 cores of &lt;nothing&gt;" in page
    assert "<nothing>" not in page


def test_rows_that_nobody_trained_are_marked_and_hold_no_figure(page):
    body = page.split("<tbody>")[1].split("</tbody>")[0]
    lines = [line for line in body.split("<tr") if "not trained" in line]
    assert len(lines) == 7
    assert {cell for line in lines for cell in re.findall(r"<td>(.*?)</td>", line)} == {"–"}


def test_a_recorded_row_tells_where_it_is_from_and_that_it_has_not_converged(page):
    (line,) = [line for line in page.split("<tr") if 'badge recorded">recorded' in line]
    assert "not converged" in line
    assert "seed 4, 12,345 samples, 8.0 min" in line
    assert "commit ccccccccc" in line
    assert page.count('badge measured">measured') == 2


def _line(content, title: str) -> str:
    """The line of Table I on a method."""
    (line,) = [line for line in _page(content).split("<tr") if f'class="name source">{title} <' in line]
    return line


def _source_of(content, row: MeasuredRow) -> str:
    """The line of Table I on `vit-lie`."""
    return _line(replace(content, rows={**content.rows, "vit-lie": row}), "ViT + Lie")


@pytest.mark.parametrize(
    ("section", "caveat"),
    [
        ("table-1", "told as well where the robots stood as one saw the other"),
        (
            "table-1",
            "Constants of the correlative search were chosen on pairs some of which are of test plans",
        ),
        ("table-1", "Its pairs are not public, so its columns stand beside ours for orientation only"),
        *((name, "pairs of one floor plan are not: they are too narrow") for name in SHARES),
        ("better", "each of the 3 intervals is of 95 % for itself, not corrected for their number"),
        *(("origin", f"<code>{value}</code>") for value in ("d" * 64, "p" * 64, "c" * 40, "w", "0")),
    ],
)
def test_the_page_says_what_its_figures_do_not_show_and_what_they_were_made_from(page, section, caveat):
    (words,) = [words for words in page.split('<section id="') if words.startswith(f"frame_error-{section}")]
    assert caveat in words


def test_sections_with_nothing_to_show_are_left_out(content, page):
    orb = content.outcomes["method"] == "orb"
    alone = {"rows": {"orb": content.rows["orb"]}, "outcomes": content.outcomes[orb]}
    bare = _page(replace(content, **alone, attention={}, comparisons=[], gallery=[]))
    optional = {f"frame_error-{name}" for name in ("better", "training", "attention", "gallery")}
    assert optional <= require_self_contained(page)
    assert not optional & require_self_contained(bare)
    assert curve_chart({}, METHODS) is None
    assert calibration_chart(content.outcomes[orb], METHODS) is None


@pytest.mark.parametrize("curve", [None, replace(FALLING, samples=np.ones(2))])
def test_without_a_curve_or_with_a_short_one_convergence_is_not_known(content, curve):
    line = _source_of(content, replace(content.rows["vit-lie"], training=replace(TRAINING, curve=curve)))
    assert "convergence not known" in line
    assert "not converged" not in line


def test_a_recorded_row_tells_what_it_was_measured_on_where_that_differs(content):
    row = content.rows["vit-lie"]
    assert "3 pairs of test, data ddddddddd" in _source_of(content, row)
    other = replace(row, conditions=replace(CONDITIONS, pairs=7, perturbation_digest="q" * 64))
    assert "7 pairs of test, not the 3 of test measured here" in _source_of(content, other)
    page = _page(replace(content, rows={**content.rows, "vit-lie": other}))
    assert page.count("recorded, 7 pairs of test") == 3  # by overlap, calibration, time


@pytest.mark.parametrize(
    ("plans", "told"),
    [
        (None, "whether it was trained on these plans is not known"),
        (2, 'badge warning">trained on 2 of these 3 plans<'),
        (0, None),
    ],
)
def test_plans_that_a_row_was_trained_on_are_told(content, plans: int | None, told: str | None):
    line = _source_of(content, replace(content.rows["vit-lie"], plans_trained_on=plans))
    assert told in line if told else "plans" not in line


@pytest.mark.parametrize(
    ("change", "name"),
    [
        ({}, "orb-2m-45deg.json"),
        ({"split": "validation"}, "orb-2m-45deg-validation.json"),
        ({"yaw_range_deg": 30.5}, "orb-2m-30.5deg.json"),
    ],
)
def test_rows_that_are_not_comparable_have_names_of_their_own(change, name):
    other = replace(CONDITIONS, **change)
    assert other.file_name("orb") == name
    assert other.comparable(CONDITIONS) == (not change)


def test_the_best_of_each_column_is_marked_and_the_paper_stands_beside(page):
    (line,) = [line for line in page.split("<tbody>")[1].split("<tr") if "Correlative" in line]
    assert 'class=" best">0.050' in line
    assert "0.425" in page.split("</table>")[0]
    assert "0.05 m" in page


@pytest.mark.parametrize(
    ("mean", "missed"),
    [
        ((0.1, 0.1, 0.02), ()),
        ((0.99, 0.95, 0.39), ("position", "heading")),
        ((0.77, 0.76, 0.40), ("heading",)),
        ((0.99, 0.95, 0.02), ("position",)),
    ],
)
def test_a_network_at_the_error_of_answering_zero_has_not_learned(content, mean, missed):
    row = content.rows["vit-lie"]
    x, y, yaw = (Interval(value=value, low=value, high=value) for value in mean)
    overall = replace(row.summary.overall, mean=(x, y, yaw))
    row = replace(row, summary=replace(row.summary, overall=overall))
    assert row.not_learned == missed
    told = _source_of(content, row)
    assert ("has not learned" in told) == bool(missed)
    assert f"has not learned {' or '.join(missed)}<" in told or not missed


_read = partial(read_recorded, kind=MeasuredRow, where="here", command="evaluate")


def test_a_recorded_row_survives_json(content):
    row = replace(content.rows["vit-lie"], plans_trained_on=1)
    values = json.loads(json.dumps(row.to_json(), allow_nan=False))
    assert _read(values).to_json() == row.to_json()
    assert _read(values).training.curve.minutes == 8.0
    del values["plans_trained_on"]
    assert _read(values).plans_trained_on is None


@pytest.mark.parametrize("damage", [{"format": 9}, {"summary": {}}, {"conditions": {"split": "test"}}])
def test_a_damaged_row_is_told(content, damage):
    with pytest.raises(StoreError, match=r"^here: "):
        _read({**content.rows["orb"].to_json(), **damage})


def test_the_papers_hough_row_stands_presumably_beside_the_global_one(content):
    names = ("hough", "hough-global")
    orb = content.outcomes[content.outcomes["method"] == "orb"]
    alone = {
        "outcomes": pd.concat([orb.assign(method=name) for name in names]),
        "rows": dict.fromkeys(names, content.rows["orb"]),
    }
    both = replace(content, **alone, comparisons=[], attention={})
    assert "1.096<small>presumably</small>" in _line(both, "Hough, global")
    assert "1.096" not in _line(both, "Hough, in the window")


@pytest.mark.parametrize(
    ("position_m", "heading_rad", "verdict"),
    [
        ((-0.8, -0.1), (0.1, 0.2), "better in position; worse in heading"),
        ((-0.8, 0.1), (-0.1, 0.2), "no difference beyond doubt"),
    ],
)
def test_a_verdict_names_what_is_better_and_what_is_worse_beyond_doubt(position_m, heading_rad, verdict):
    position, heading, success = (
        Interval(value=(low + high) / 2.0, low=low, high=high)
        for low, high in (position_m, heading_rad, (-0.2, 0.1))
    )
    compared = Comparison(
        better="orb", other="hough", position_m=position, heading_rad=heading, success=success
    )
    assert compared.verdict == verdict


def test_symmetric_scenes_stand_apart_where_they_were_told_apart(content):
    weights = np.ones((5, 3))
    apart = Symmetry.of(np.array([0.7, 0.2, 0.59]), content.outcomes, weights)
    words = _page(replace(content, symmetry=apart))
    assert "1 of 3 pairs have such a map, and the median over all pairs is 59 %" in words
    assert "symmetric, 1 pairs" in words
    none = Symmetry.of(np.zeros(3), content.outcomes, weights)
    assert "symmetric, none" in _page(replace(content, symmetry=none))
    assert "Symmetric scenes apart" not in _page(content)


def test_the_best_are_those_of_least_error_and_most_successes_whatever_their_order(content):
    x_m = {"b": 0.2, "a": 0.1, "c": 1.9}
    # One success each, where x is small; the overlaps of the two pairs are in two bins.
    one = {name: np.array([[x, -x, 0.0], [2.0 - x, 0.0, 0.0]]) for name, x in x_m.items()}
    found = replace(content, outcomes=tables_of(overlap=[0.05, 0.9], **one))
    assert found.best_by_overlap == {"< 0.1": "a", "> 0.5": "c"}
    assert found.best[1] == "a"
    assert found.measured == ["b", "a", "c"]
    assert found.best[3] == "b"  # the first of those with as many
    assert found.ranked == ["a", "b", "c"]
