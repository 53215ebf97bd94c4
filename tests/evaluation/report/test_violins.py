from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("seaborn")

import pandas as pd
from matplotlib.collections import FillBetweenPolyCollection
from matplotlib.figure import Figure
from scipy.stats import norm

from rendezvous.evaluation.report.violins import Component, draw_violins, violin_chart

METRES = Component(column="x", name="Δx", unit="m")


def _errors(**groups) -> pd.DataFrame:
    """A table of groups of values of x."""
    names = [name for name, values in groups.items() for _ in values]
    group = pd.Categorical(names, list(groups))
    return pd.DataFrame({"x": np.concatenate(list(groups.values())), "group": group})


def _drawn(errors: pd.DataFrame, **settings):
    component = Component(**{"column": "x", "name": "Δx", "unit": "m", **settings})
    return draw_violins(Figure(), errors, "group", [component])[0]


def _violins(panel) -> list[FillBetweenPolyCollection]:
    return [drawn for drawn in panel.collections if isinstance(drawn, FillBetweenPolyCollection)]


def _dots(panel) -> list[list[float]]:
    dots = [line.get_xdata().tolist() for line in panel.lines if line.get_marker() == "o"]
    return [values for values in dots if values]


def _words(texts) -> list[str]:
    return [text.get_text() for text in texts]


def test_a_box_has_the_quartiles_and_whiskers_that_end_at_values():
    # Quartiles are 2, 4, 6; whiskers reach up to 6 + 1.5 · 4 = 12.
    values = np.array([*np.arange(8.0), 100.0] + [4.0] * 4)
    panel = _drawn(_errors(all=values), axis=(0.0, 120.0))
    box_x = panel.patches[0].get_path().vertices[:, 0]
    assert (box_x.min(), box_x.max()) == pytest.approx(tuple(np.quantile(values, (0.25, 0.75))))
    ends = {float(x) for line in panel.lines for x in line.get_xdata()}
    assert {0.0, 7.0} <= ends
    assert _dots(panel) == [[100.0]]


def test_groups_stand_from_the_top_down_with_their_counts():
    panel = _drawn(_errors(near=np.zeros(1200), far=[1.0, np.nan, 2.0, np.nan], unmade=[np.nan]))
    assert _words(panel.get_yticklabels()) == ["near\nn = 1,200", "far\nn = 2 of 4", "unmade\nn = 0 of 1"]
    assert _words(panel.texts) == ["none"]
    lower, upper = panel.get_ylim()
    assert lower > upper
    assert np.isfinite(_drawn(_errors(unmade=[np.nan])).get_xlim()).all()


def test_an_estimate_that_was_not_made_is_in_no_panel():
    errors = pd.DataFrame({"x": [1.0, 2.0, np.nan], "yaw": [np.nan, 3.0, np.nan]})
    errors["group"] = pd.Categorical(["all"] * 3)
    panels = draw_violins(Figure(), errors, "group", [METRES, Component(column="yaw", name="Δψ", unit="°")])
    assert [_dots(panel) for panel in panels] == [[[2.0]], [[3.0]]]
    assert [panel.get_title(loc="left") or panel.get_title() for panel in panels] == ["Δx", "Δψ"]
    assert [panel.get_xlabel() for panel in panels] == ["error [m]", "error [°]"]


@pytest.mark.parametrize(
    ("values", "limits"),
    [
        ([-0.1, 0.1], (-0.125, 0.125)),
        (np.linspace(0.0, 8.0, 9), (0.0, 10.0)),
        # The one negative value lies beyond the whiskers, which alone would begin at zero.
        ([*np.linspace(0.0, 8.0, 9), -100.0], (-10.0, 10.0)),
        (np.zeros(20), (0.0, 1.0)),
    ],
)
def test_the_axis_holds_the_whiskers_and_has_zero_at_its_end_or_middle(values, limits):
    assert _drawn(_errors(all=values)).get_xlim() == pytest.approx(limits)
    assert _drawn(_errors(all=values), axis=(-2.0, 4.0)).get_xlim() == (-2.0, 4.0)


def test_the_share_beyond_the_axis_is_noted():
    panel = _drawn(_errors(some=[-3.0, 0.0, 0.5, 2.0], none=[1.0, -1.0]), axis=(-1.0, 1.0))
    assert _words(panel.texts) == ["50.0 % beyond"]


def test_few_values_are_dots_and_many_a_violin_where_they_are_densest():
    values = np.concatenate([np.full(90, 0.25), np.linspace(-1.0, 1.0, 21)])
    panel = _drawn(_errors(first=values, few=values[-9:], many=values), axis=(-2.0, 2.0))
    assert len(_violins(panel)) == 2
    for row, violin in zip((0, 2), _violins(panel), strict=True):
        (outline,) = violin.get_paths()
        x, y = outline.vertices.T
        assert (x.min(), x.max()) == pytest.approx((-1.0, 1.0))
        assert x[np.argmax(y)] == pytest.approx(0.25, abs=0.02)
        assert y.max() == pytest.approx(row + 0.36), "a violin leaves its line"
    assert values[-9:].tolist() in _dots(panel)


def test_a_violin_is_the_density_of_its_values():
    values = norm.ppf((np.arange(2000) + 0.5) / 2000)
    panel = _drawn(_errors(normal=values, equal=np.zeros(20)), axis=(-3.0, 3.0))
    (outline,) = _violins(panel)[0].get_paths()
    upper = outline.vertices[outline.vertices[:, 1] > 0.0]
    heights = upper[:, 1] / upper[:, 1].max()
    assert heights == pytest.approx(np.exp(-0.5 * upper[:, 0] ** 2), abs=0.03)


def test_the_chart_is_the_same_svg_each_time():
    errors = _errors(all=np.random.default_rng(0).normal(size=50))
    charts = {violin_chart(errors, "group", [METRES]) for _ in range(2)}
    assert [(chart[:4], "n = 50" in chart) for chart in charts] == [("<svg", True)]
