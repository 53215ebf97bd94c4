from __future__ import annotations

import cv2
import numpy as np
import pytest

pytest.importorskip("matplotlib")

from matplotlib.collections import FillBetweenPolyCollection
from matplotlib.figure import Figure
from rendezvous.evaluation.relative_pose.violins import Box, Component, draw_violins, violin_chart
from scipy.stats import norm

METRES = [Component(name="Δx", unit="m")]


def _drawn(groups, components=METRES):
    return draw_violins(Figure(), groups, components)


def _column(*values: float) -> np.ndarray:
    return np.array(values, dtype=np.float64)[:, None]


def _violins(panel) -> list[FillBetweenPolyCollection]:
    return [drawn for drawn in panel.collections if isinstance(drawn, FillBetweenPolyCollection)]


def _labels(panel) -> list[str]:
    return [label.get_text() for label in panel.get_yticklabels()]


def _words(panel) -> list[str]:
    return [text.get_text() for text in panel.texts]


def test_a_box_has_the_quartiles_and_whiskers_that_end_at_values():
    # Quartiles of 0 … 8 are 2, 4, 6; whiskers reach up to 4 - 2 · 3 and 6 + 1.5 · 4 = 12.
    assert Box.of(np.arange(9.0)) == Box(low=0.0, lower=2.0, median=4.0, upper=6.0, high=8.0)
    far = Box.of(np.array([0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 100.0]))
    assert (far.median, far.high) == (4.0, 7.0)
    assert Box.of(np.array([3.0])) == Box(low=3.0, lower=3.0, median=3.0, upper=3.0, high=3.0)


def test_groups_stand_from_the_top_down_with_their_counts():
    (panel,) = _drawn({"near": np.zeros((1200, 1)), "far": _column(1.0, np.nan, 2.0, np.nan)})
    assert _labels(panel) == ["near\nn = 1,200", "far\nn = 2 of 4"]
    lower, upper = panel.get_ylim()
    assert lower > upper


def test_an_estimate_that_was_not_made_is_in_no_panel():
    errors = np.array([[1.0, np.nan], [2.0, 3.0], [np.nan, np.nan]])
    components = [*METRES, Component(name="Δψ", unit="°")]
    for panel, value in zip(_drawn({"all": errors}, components), (2.0, 3.0), strict=True):
        (dots,) = [line for line in panel.lines if line.get_marker() == "o"]
        assert dots.get_xdata().tolist() == [value]


def test_an_empty_group_keeps_its_line_and_says_so():
    nothing, unmade = np.zeros((0, 1)), np.full((3, 1), np.nan)
    (panel,) = _drawn({"empty": nothing, "unmade": unmade, "some": _column(-1.0, 1.0)})
    assert _labels(panel) == ["empty\nn = 0", "unmade\nn = 0 of 3", "some\nn = 2"]
    assert _words(panel) == ["none", "none"]
    (panel,) = _drawn({"empty": nothing})
    assert np.isfinite(panel.get_xlim()).all()


def test_panels_have_name_unit_and_an_axis_of_their_own():
    errors = np.array([[-0.1, 5.0], [0.1, 1.0]])
    given = Component(name="Δψ", unit="°", axis=(-2.0, 4.0))
    left, right = _drawn({"all": errors}, [*METRES, given])
    assert [panel.get_title(loc="left") or panel.get_title() for panel in (left, right)] == ["Δx", "Δψ"]
    assert [panel.get_xlabel() for panel in (left, right)] == ["error [m]", "error [°]"]
    assert left.get_xlim() == pytest.approx((-0.125, 0.125))
    assert right.get_xlim() == (-2.0, 4.0)


def test_the_axis_of_distances_begins_at_zero_and_that_of_signed_errors_has_it_in_the_middle():
    distances = np.linspace(0.0, 8.0, 9)
    (panel,) = _drawn({"all": distances[:, None]})
    assert panel.get_xlim() == (0.0, 10.0)
    # The one negative value lies beyond the whiskers, which alone would begin at zero.
    (panel,) = _drawn({"all": np.append(distances, -100.0)[:, None]})
    lower, upper = panel.get_xlim()
    assert lower == -upper


def test_errors_that_are_all_zero_have_an_axis_and_a_violin():
    (panel,) = _drawn({"all": np.zeros((20, 1))})
    assert panel.get_xlim() == (0.0, 1.0)
    assert len(_violins(panel)) == 1


def test_what_lies_beyond_the_axis_is_told_as_a_share():
    component = Component(name="Δx", unit="m", axis=(-1.0, 1.0))
    (panel,) = _drawn({"some": _column(-3.0, 0.0, 0.5, 2.0), "none": _column(1.0, -1.0)}, [component])
    assert _words(panel) == ["50.0 % beyond"]


def test_few_values_are_dots_and_many_a_violin_where_they_are_densest():
    values = np.concatenate([np.full(90, 0.25), np.linspace(-1.0, 1.0, 21)])
    component = Component(name="Δx", unit="m", axis=(-2.0, 2.0))
    (panel,) = _drawn({"few": values[-9:, None], "many": values[:, None]}, [component])
    (violin,) = _violins(panel)
    (outline,) = violin.get_paths()
    x, y = outline.vertices.T
    assert (x.min(), x.max()) == pytest.approx((-1.0, 1.0))
    assert x[np.argmax(y)] == pytest.approx(0.25, abs=0.02)
    assert 1.0 < y.max() < 1.5, "the violin of the second group leaves its line"


def test_a_violin_is_the_density_of_its_values():
    values = norm.ppf((np.arange(2000) + 0.5) / 2000)
    component = Component(name="Δx", unit="m", axis=(-3.0, 3.0))
    (panel,) = _drawn({"normal": values[:, None]}, [component])
    (outline,) = _violins(panel)[0].get_paths()
    upper = outline.vertices[outline.vertices[:, 1] > 0.0]
    heights = upper[:, 1] / upper[:, 1].max()
    assert heights == pytest.approx(np.exp(-0.5 * upper[:, 0] ** 2), abs=0.03)


def test_the_chart_is_the_same_png_each_time():
    groups = {"all": np.random.default_rng(0).normal(size=(50, 1))}
    encoded = violin_chart(groups, METRES, colours={"all": (203, 36, 49)})
    assert encoded == violin_chart(groups, METRES, colours={"all": (203, 36, 49)})
    assert encoded != violin_chart(groups, METRES)
    assert cv2.imdecode(np.frombuffer(encoded, np.uint8), cv2.IMREAD_COLOR).shape[1] == 1700
