import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pytest import approx

from rendezvous.alignment.window import FREE_CELL, OCCUPIED_CELL, MapWindow, SearchRange
from rendezvous.baselines.correlation import SCORE_SCALE, Correlation, correlation, likelihood_field
from rendezvous.geometry.se2 import SE2
from tests.baselines.reference import reference_scores
from tests.baselines.windows import window_with

SMALL = SearchRange(xy_m=0.6, yaw_rad=0.3)


def scores_of(window: MapWindow, search: SearchRange = SMALL) -> Correlation:
    return correlation(window, search, heading_step_rad=0.1, blur_m=0.1, free_penalty=0.8)


def test_a_field_is_one_on_walls_minus_the_penalty_on_floor_and_zero_in_the_unknown():
    cells = np.zeros((40, 40), np.uint8)
    cells[:, :30], cells[20, :30] = FREE_CELL, OCCUPIED_CELL
    field = likelihood_field(cells, blur_cells=1.0, free_penalty=0.8)
    assert (field[20, :30] == SCORE_SCALE).all()
    beside = math.exp(-0.5)
    assert (field[21, :30] == round(SCORE_SCALE * (beside - 0.8 * (1 - beside)))).all()
    assert (field[:10, :30] == -0.8 * SCORE_SCALE).all()
    assert (field[:, 36:] == 0).all()


def test_a_map_without_walls_only_speaks_against_walls():
    cells = np.full((8, 8), FREE_CELL, np.uint8)
    assert (likelihood_field(cells, blur_cells=1.0, free_penalty=0.5) == -SCORE_SCALE // 2).all()


def test_scores_are_those_of_the_formula_computed_by_fourier_transform():
    window = window_with(SE2(0.2, -0.3, 0.1), plan=1).pooled(2)
    scores = scores_of(window)
    side = 2 * scores.reach + 1
    for heading, yaw_rad in enumerate(scores.headings_rad):
        expected = reference_scores(window, yaw_rad, scores.reach, blur_cells=1.0, free_penalty=0.8)
        np.testing.assert_array_equal(scores.scores(heading, 0, 0, side, side), expected)


def test_a_block_is_cut_from_all_scores():
    scores = scores_of(window_with(SE2(0.2, -0.3, 0.1)).pooled(2))
    side = 2 * scores.reach + 1
    whole = scores.scores(2, 0, 0, side, side)
    np.testing.assert_array_equal(scores.scores(2, 3, 5, 4, 2), whole[3:7, 5:7])


@settings(max_examples=25, deadline=None)
@given(st.integers(-5, 5), st.integers(-5, 5), st.sampled_from([-math.pi / 2, 0.0, math.pi / 2]))
def test_maps_that_differ_by_a_motion_of_the_grid_score_best_at_it(x: int, y: int, yaw_rad: float):
    size, rng = 48, np.random.default_rng(0)
    aligned = np.full((size, size), FREE_CELL, np.uint8)
    aligned[tuple(rng.integers(14, 34, (2, 60)))] = OCCUPIED_CELL
    # moved(u) = aligned(θ⁻¹ u) for θ = (t, ψ): first the turn about the window's centre, then t.
    turned = np.rot90(aligned, k=-round(yaw_rad / (math.pi / 2)))
    moved = np.roll(turned, (y, x), axis=(0, 1))
    window = MapWindow(cells=np.stack([aligned, moved]), cell_m=0.1)
    search = SearchRange(xy_m=0.5, yaw_rad=math.pi / 2)
    scores = correlation(window, search, heading_step_rad=math.pi / 2, blur_m=0.05, free_penalty=1.0)
    volume = np.array([scores.scores(h, 0, 0, 11, 11) for h in range(3)])
    heading, row, col = (int(i) for i in np.unravel_index(volume.argmax(), volume.shape))
    expected = [0.1 * x, 0.1 * y, yaw_rad]
    assert scores.theta(heading, row, col).as_array() == approx(expected, abs=1e-9)


@pytest.mark.parametrize("step_rad", [0.1, 0.07, 1.0])
def test_headings_reach_both_ends_in_steps_no_larger_than_asked(step_rad: float):
    window = window_with(SE2.identity()).pooled(2)
    search = SearchRange(xy_m=0.1, yaw_rad=0.5)
    scores = correlation(window, search, heading_step_rad=step_rad, blur_m=0.1, free_penalty=1.0)
    assert scores.headings_rad[[0, -1]] == approx([-0.5, 0.5])
    assert np.diff(scores.headings_rad).max() <= step_rad + 1e-12
    assert 0.0 in scores.headings_rad


def test_the_full_circle_has_no_heading_twice():
    window = window_with(SE2.identity()).pooled(2)
    search = SearchRange(xy_m=0.1, yaw_rad=math.pi)
    scores = correlation(window, search, heading_step_rad=0.7, blur_m=0.1, free_penalty=1.0)
    gaps = np.diff(np.append(scores.headings_rad, scores.headings_rad[0] + 2 * math.pi))
    assert gaps == approx(np.full(len(gaps), 2 * math.pi / len(gaps)))
    assert gaps.max() <= 0.7
