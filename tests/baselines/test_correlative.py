import math
from dataclasses import replace

import numpy as np
import pytest

from rendezvous.alignment.frame_error import pose_difference
from rendezvous.alignment.window import FREE_CELL, OCCUPIED_CELL, MapWindow, SearchRange
from rendezvous.baselines.branch_and_bound import Apart, best_cell, block_bounds
from rendezvous.baselines.correlative import CorrelativeSearch
from rendezvous.geometry.se2 import SE2
from tests.baselines.windows import real_window, window_with, without_walls


def assert_near(theta_hat: SE2 | None, theta: SE2, *, within_m: float, within_deg: float) -> None:
    assert theta_hat is not None
    error = pose_difference(theta_hat, theta)
    assert math.hypot(error.x_m, error.y_m) < within_m
    assert abs(error.yaw_rad) < math.radians(within_deg)


@pytest.mark.parametrize("seed", range(4))
def test_it_finds_any_frame_error_of_the_papers_range(seed: int):
    rng = np.random.default_rng(seed)
    # Uniform in its components, in the axes of m0; the window turned by any angle.
    T_c_v = SE2(0.0, 0.0, rng.uniform(-math.pi, math.pi))
    theta = SE2(*rng.uniform(-2.0, 2.0, 2), rng.uniform(-math.pi / 4, math.pi / 4))
    theta_v = T_c_v.inverse() @ theta @ T_c_v
    window = window_with(theta_v, plan=seed % 4, turn_rad=T_c_v.yaw_rad)
    estimate = CorrelativeSearch()(window)
    assert_near(estimate.theta, theta_v, within_m=0.03, within_deg=0.5)
    assert not estimate.ambiguous
    assert_near(CorrelativeSearch(subcell=False)(window).theta, theta_v, within_m=0.15, within_deg=1.5)


def test_with_every_heading_it_finds_a_robot_seen_back_to_front():
    theta = SE2(1.2, -0.8, math.radians(175.0))
    search = CorrelativeSearch(search=SearchRange(xy_m=2.0, yaw_rad=math.pi))
    assert_near(search(window_with(theta)).theta, theta, within_m=0.03, within_deg=0.5)


def test_its_covariance_covers_its_error():
    for seed in range(4):
        theta = SE2(*np.random.default_rng(seed).uniform(-0.7, 0.7, 3))
        estimate = CorrelativeSearch()(window_with(theta, plan=seed))
        assert estimate.theta is not None
        assert estimate.covariance is not None
        error = pose_difference(estimate.theta, theta).as_array()
        assert error @ np.linalg.solve(estimate.covariance, error) < 11.3  # 99 % of chi-squared of 3
        assert np.sqrt(np.diag(estimate.covariance)).max() < 0.05


@pytest.mark.parametrize("channel", [0, 1])
def test_a_map_without_walls_is_a_failure_that_says_so(channel: int):
    estimate = CorrelativeSearch()(without_walls(window_with(SE2.identity()), channel))
    assert estimate.theta is None
    assert estimate.reason == f"map {channel} has no walls in the window"


def test_walls_that_no_motion_brings_together_are_a_failure_that_says_so():
    cells = np.full((2, 384, 384), FREE_CELL, np.uint8)
    cells[0, 40, 40], cells[1, 340, 340] = OCCUPIED_CELL, OCCUPIED_CELL
    estimate = CorrelativeSearch()(MapWindow(cells=cells, cell_m=0.05))
    assert estimate.theta is None
    assert "no motion in the range" in estimate.reason


def striped() -> MapWindow:
    """Walls at equal distances of 1.5 m, the same in both maps."""
    cells = np.zeros((2, 384, 384), np.uint8)
    cells[:, 40:344, 40:344] = FREE_CELL
    cells[:, 40:344:30, 40:344] = OCCUPIED_CELL
    return MapWindow(cells=cells, cell_m=0.05)


def test_evenly_spaced_walls_are_ambiguous():
    estimate = CorrelativeSearch()(striped())
    assert estimate.theta is not None
    assert estimate.ambiguous


def test_it_is_ambiguous_from_the_ratio_of_its_second_peak_on():
    search, window = CorrelativeSearch(), striped()
    scores = search.correlation(window)
    bounds = block_bounds(scores)
    best = best_cell(scores, bounds)
    second = best_cell(scores, bounds, apart=Apart(centre=best, yaw_rad=math.radians(10.0), cells=5))
    ratio = second.score / best.score
    assert replace(search, ambiguous_ratio=0.99 * ratio)(window).ambiguous
    assert not replace(search, ambiguous_ratio=1.01 * ratio)(window).ambiguous


def test_a_window_at_the_cell_of_the_search_is_not_pooled():
    theta = SE2(0.5, -0.4, 0.3)
    assert_near(CorrelativeSearch()(window_with(theta).pooled(2)).theta, theta, within_m=0.08, within_deg=1.0)


@pytest.mark.parametrize("seed", range(3))
def test_it_agrees_with_the_registration_of_the_real_pair(real_data, seed: int):
    rng = np.random.default_rng(seed)
    theta = SE2(*rng.uniform(-1.4, 1.4, 2), rng.uniform(-0.7, 0.7))
    estimate = CorrelativeSearch()(real_window(real_data, theta, turn_rad=rng.uniform(-3.0, 3.0)))
    assert_near(estimate.theta, theta, within_m=0.3, within_deg=3.0)


def test_its_answer_is_what_it_was_when_it_was_measured():
    estimate = CorrelativeSearch()(window_with(SE2(1.1, -0.6, 0.4), turn_rad=1.0))
    assert estimate.theta.as_array() == pytest.approx([1.09911, -0.60837, 0.39924], abs=1e-4)
    sigmas = np.sqrt(np.diag(estimate.covariance))
    assert sigmas == pytest.approx([0.027366, 0.020494, 0.0076138], rel=1e-3)
