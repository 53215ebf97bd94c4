from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from pytest import approx

from rendezvous.alignment.window import FREE_CELL, MapWindow
from rendezvous.evaluation.frame_error.estimates import outcome_table
from rendezvous.evaluation.frame_error.gallery import PANEL_PX, attention_panel, chosen_pairs, panels
from rendezvous.evaluation.pictures.canvas import BLUE, RED
from rendezvous.evaluation.pictures.map_panels import BOTH
from rendezvous.geometry.occupancy_grid import FREE, OCCUPIED, OccupancyGrid
from rendezvous.geometry.se2 import SE2
from tests.evaluation.toy_pairs import outcomes_of, toy_outcomes, toy_pair, toy_sample


def _pixels(image, colour) -> int:
    return int((image == colour).all(axis=2).sum())


@pytest.fixture(scope="module")
def drawn():
    pair = toy_pair(3)
    found = {
        "perfect": toy_outcomes([pair], off=SE2.identity()),
        "off": toy_outcomes([pair], off=SE2(0.5, 0.5, 0.2)),
        "failing": toy_outcomes([pair], off=SE2.identity(), failing=True),
    }
    return {
        panel.name: panel for panel in panels(pair, toy_sample(pair), outcome_table(found, np.array([0.5])))
    }


def test_walls_of_both_maps_fall_together_only_where_the_transform_is_right(drawn):
    assert (drawn["perfect"].image == drawn["truth"].image).mean() > 0.999
    assert drawn["perfect"].position_m == approx(0.0, abs=1e-9)
    together = {name: _pixels(panel.image, BOTH) for name, panel in drawn.items()}
    assert together["truth"] > 2 * together["off"]
    assert together["truth"] > 2 * together["input"]
    assert _pixels(drawn["off"].image, RED) > _pixels(drawn["truth"].image, RED)
    assert _pixels(drawn["off"].image, BLUE) > _pixels(drawn["truth"].image, BLUE)


def test_a_failure_shows_the_input_and_says_so(drawn):
    assert (drawn["failing"].image == drawn["input"].image).all()
    assert drawn["failing"].failed
    assert drawn["failing"].position_m == approx(drawn["input"].position_m)
    assert drawn["truth"].image.shape == (PANEL_PX, PANEL_PX, 3)


def test_best_median_worst_and_low_overlap_are_shown_once_each():
    error = np.zeros((21, 3))
    error[:, 0] = np.random.default_rng(0).permutation(21)
    overlap = np.linspace(1.0, 0.05, 21)
    chosen = dict(chosen_pairs(outcomes_of(error, overlap=overlap)))
    assert error[chosen["best"], 0] == 0.0
    assert error[chosen["median"], 0] == 10.0
    assert error[chosen["worst"], 0] == 20.0
    assert chosen["low overlap"] == max((19, 20), key=lambda pair: error[pair, 0])
    assert chosen_pairs(outcomes_of(error[:1])) == [("best", 0)]


def test_attention_is_drawn_where_it_lies_and_an_even_share_not_at_all():
    window = MapWindow(cells=np.full((2, 48, 48), FREE_CELL, np.uint8), cell_m=0.1)
    even = attention_panel(window, np.full((12, 12), 1.0 / 144))
    attention = np.zeros((12, 12))
    attention[10, 1] = 1.0  # row grows with +y: near the top, to the left
    hot = np.argwhere((attention_panel(window, attention) != even).any(axis=2))
    row, col = hot.mean(axis=0) / PANEL_PX * 12
    assert (row, col) == (approx(1.5, abs=0.3), approx(1.5, abs=0.3))
    assert len(np.unique(even.reshape(-1, 3), axis=0)) == 1


def test_y_points_up_and_x_to_the_right():
    cells = np.full((20, 40), FREE, np.uint8)
    cells[16:, 30:] = OCCUPIED
    grid, empty = (
        OccupancyGrid(cells=seen, resolution_m=0.1, T_m_g=SE2.identity()) for seen in (cells, cells[:8])
    )
    toy, T_m1_r1 = toy_pair(3), SE2(1.0, 0.5, 0.0)
    pair = replace(toy, grid_0=grid, grid_1=empty, T_m0_m1=SE2.identity(), T_m1_r1=T_m1_r1)
    truth, *_ = panels(pair, toy_sample(pair), outcomes_of(np.zeros((1, 3)))[:0])
    row, col = np.argwhere((truth.image == RED).all(axis=2)).mean(axis=0) / PANEL_PX
    # 5 m across, around (2 m, 1 m); the walls are around (3.5 m, 1.8 m).
    assert (row, col) == (approx(0.5 - 0.8 / 5.0, abs=0.01), approx(0.5 + 1.5 / 5.0, abs=0.01))
