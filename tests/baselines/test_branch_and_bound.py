import math

import numpy as np
import pytest
from pytest import approx

from rendezvous.alignment.window import FREE_CELL, OCCUPIED_CELL, MapWindow, SearchRange
from rendezvous.baselines.branch_and_bound import Apart, ScoredCell, best_cell, block_bounds
from rendezvous.baselines.correlation import BLOCK, Correlation, correlation
from rendezvous.geometry.se2 import SE2, Array
from tests.baselines.reference import reference_scores
from tests.baselines.windows import real_window, window_with

SETTINGS = {"blur_m": 0.07, "free_penalty": 1.3}
PAPER = SearchRange.covering(xy_m=2.0, yaw_rad=math.pi / 4)


def exhaustive(window: MapWindow, scores: Correlation) -> Array:
    """(H, R, C): every score, by an independent way."""
    return np.array(
        [
            reference_scores(window, yaw_rad, scores.reach, blur_cells=0.7, free_penalty=1.3)
            for yaw_rad in scores.headings_rad
        ]
    )


def noise(seed: int) -> MapWindow:
    """A window of which every cell is drawn at random, where many scores are close to each other."""
    rng = np.random.default_rng(seed)
    values = np.array([0, FREE_CELL, OCCUPIED_CELL], np.uint8)
    return MapWindow(cells=rng.choice(values, (2, 40, 40), p=[0.3, 0.6, 0.1]), cell_m=0.1)


def assert_found(window: MapWindow, search: SearchRange, heading_step_rad: float) -> None:
    scores = correlation(window, search, heading_step_rad=heading_step_rad, **SETTINGS)
    volume = exhaustive(window, scores)
    best = best_cell(scores, block_bounds(scores))
    if volume.max() <= 0:
        assert best is None
        return
    heading, row, col = np.unravel_index(volume.argmax(), volume.shape)
    assert best == ScoredCell(score=int(volume.max()), heading=int(heading), row=int(row), col=int(col))


@pytest.mark.parametrize("seed", range(24))
def test_it_finds_the_cell_of_the_exhaustive_search_in_noise(seed: int):
    search = SearchRange(xy_m=(0.3, 0.5, 1.0, 1.7)[seed % 4], yaw_rad=(0.2, math.pi)[seed % 2])
    assert_found(noise(seed), search, heading_step_rad=0.3)


@pytest.mark.parametrize("plan", range(2))
def test_it_finds_the_cell_of_the_exhaustive_search_in_a_building(plan: int):
    rng = np.random.default_rng(plan)
    # Uniform over the paper's range.
    theta = SE2(*rng.uniform(-2.0, 2.0, 2), rng.uniform(-0.7, 0.7))
    window = window_with(theta, plan=plan, turn_rad=rng.uniform(-3.0, 3.0)).pooled(2)
    assert_found(window, PAPER, heading_step_rad=math.radians(6.0))


def test_it_finds_the_cell_of_the_exhaustive_search_in_real_maps(real_data):
    window = real_window(real_data, SE2(1.5, -1.2, 0.4), turn_rad=1.0).pooled(2)
    assert_found(window, PAPER, heading_step_rad=math.radians(6.0))


@pytest.mark.parametrize(("seed", "xy_m", "tight"), [(3, 1.3, 0.7), (4, 0.4, 0.92), (5, 1.0, 0.75)])
def test_no_score_in_a_block_exceeds_its_bound_and_some_bounds_are_tight(
    seed: int, xy_m: float, tight: float
):
    search = SearchRange(xy_m=xy_m, yaw_rad=0.5)
    scores = correlation(noise(seed), search, heading_step_rad=0.25, blur_m=0.1, free_penalty=1.0)
    bounds, side = block_bounds(scores), 2 * scores.reach + 1
    slack = []
    for heading, row, col in np.ndindex(bounds.shape):
        rows, cols = (min(BLOCK, side - BLOCK * first) for first in (row, col))
        block = scores.scores(heading, BLOCK * row, BLOCK * col, rows, cols)
        slack.append(bounds[heading, row, col] - block.max())
    assert min(slack) >= 0
    assert min(slack) < tight * np.median(slack)


def test_a_tie_goes_to_the_first_cell_though_its_bound_is_tight_and_its_block_opened_last():
    cells = np.zeros((2, 40, 40), np.uint8)
    cells[0, 20, 20] = cells[1, 20, [15, 24, 27]] = OCCUPIED_CELL
    search = SearchRange(xy_m=0.8, yaw_rad=0.0)
    scores = correlation(MapWindow(cells=cells, cell_m=0.1), search, heading_step_rad=0.1, **SETTINGS)
    volume = scores.scores(0, 0, 0, 17, 17)
    assert np.argwhere(volume == volume.max()).tolist() == [[8, 3], [8, 12], [8, 15]]
    bounds = block_bounds(scores)
    assert bounds[0, 2, 0] == volume.max() < bounds[0, 2, 3]
    assert best_cell(scores, bounds) == ScoredCell(score=200, heading=0, row=8, col=3)


@pytest.mark.parametrize("seed", range(12))
def test_of_equal_scores_the_first_cell_is_found_in_whatever_order_blocks_are_opened(seed: int):
    cells = np.zeros((2, 40, 40), np.uint8)
    rng = np.random.default_rng(seed)
    for channel in cells:
        channel[tuple(rng.integers(15, 25, (2, 3)))] = OCCUPIED_CELL
    assert_found(MapWindow(cells=cells, cell_m=0.1), SearchRange(xy_m=1.0, yaw_rad=0.6), heading_step_rad=0.2)


def test_the_best_cell_apart_is_the_best_of_the_others():
    scores = correlation(
        noise(5), SearchRange(xy_m=1.0, yaw_rad=0.6), heading_step_rad=0.2, blur_m=0.1, free_penalty=0.3
    )
    bounds, side = block_bounds(scores), 2 * scores.reach + 1
    first = best_cell(scores, bounds)
    assert first is not None
    second = best_cell(scores, bounds, apart=Apart(centre=first, yaw_rad=0.3, cells=4))
    assert second is not None
    volume = np.array([scores.scores(h, 0, 0, side, side) for h in range(len(scores.headings_rad))])
    heading, row, col = np.indices(volume.shape)
    near = (abs(heading - first.heading) <= 1) & (abs(row - first.row) <= 4) & (abs(col - first.col) <= 4)
    assert second.score == approx(np.where(near, -(10**9), volume).max())
    assert not near[second.heading, second.row, second.col]


def test_the_ends_of_a_limited_range_of_headings_are_apart_and_those_of_a_circle_are_not():
    window = noise(6)
    for yaw_rad, expected in ((0.6, (0, 0, 0, 0)), (math.pi, (1, 4, 1, 4))):
        scores = correlation(window, SearchRange(xy_m=0.2, yaw_rad=yaw_rad), heading_step_rad=0.2, **SETTINGS)
        last = len(scores.headings_rad) - 1
        centre = ScoredCell(score=0, heading=0, row=2, col=2)
        left_out = Apart(centre=centre, yaw_rad=0.3, cells=1).left_out(scores, last)
        assert left_out == expected


def test_nothing_is_found_where_every_score_is_negative():
    cells = np.full((2, 40, 40), FREE_CELL, np.uint8)
    cells[0, 20, 20] = OCCUPIED_CELL
    window = MapWindow(cells=cells, cell_m=0.1)
    scores = correlation(window, SearchRange(xy_m=0.3, yaw_rad=0.1), heading_step_rad=0.1, **SETTINGS)
    assert best_cell(scores, block_bounds(scores)) is None
