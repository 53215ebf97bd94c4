import math

import numpy as np
import pytest
from pytest import approx

from rendezvous.alignment.estimate import Identity
from rendezvous.alignment.frame_error import pose_difference
from rendezvous.alignment.window import OCCUPIED_CELL, MapWindow
from rendezvous.baselines.orb import OrbRansac
from rendezvous.geometry.se2 import SE2
from tests.baselines.windows import real_window, window_with


def test_it_finds_a_map_that_was_shifted_and_turned_by_a_quarter():
    house = window_with(SE2.identity()).cells[0]
    moved = np.roll(np.rot90(house, k=1), (12, -8), axis=(0, 1))  # a quarter turn clockwise, seen with y up
    estimate = OrbRansac()(MapWindow(cells=np.stack([house, moved]), cell_m=0.05))
    assert estimate.theta is not None
    assert estimate.theta.as_array() == approx([-0.4, 0.6, -math.pi / 2], abs=0.05)


@pytest.mark.parametrize("turn_rad", [0.0, 1.0, -2.0])
def test_it_agrees_with_the_registration_of_the_real_pair(real_data, turn_rad: float):
    theta = SE2(1.0, -0.5, 0.4)
    estimate = OrbRansac()(real_window(real_data, theta, turn_rad=turn_rad))
    assert estimate.theta is not None
    error = pose_difference(estimate.theta, theta)
    assert math.hypot(error.x_m, error.y_m) < 0.3
    assert abs(error.yaw_rad) < math.radians(4.0)


def test_too_few_matches_are_a_failure_that_says_so():
    window = window_with(SE2.identity())
    blank = MapWindow(cells=np.stack([window.cells[0], np.zeros_like(window.cells[0])]), cell_m=0.05)
    estimate = OrbRansac()(blank)
    assert estimate.theta is None
    assert estimate.reason == "0 matches; at least 6 are needed"


def test_matches_that_do_not_fit_together_are_a_failure_that_says_so():
    """Boxes scattered at random (uniform), other ones in each map."""
    rng = np.random.default_rng(0)
    cells = np.ones((2, 384, 384), np.uint8)
    for channel, row, col in zip(rng.integers(0, 2, 300), *rng.integers(0, 370, (2, 300)), strict=True):
        cells[channel, row : row + 8, col : col + 12] = OCCUPIED_CELL
    estimate = OrbRansac(ratio=0.95)(MapWindow(cells=cells, cell_m=0.05))
    assert estimate.theta is None
    assert "confidence" in estimate.reason


def test_the_identity_is_the_identity():
    estimate = Identity()(window_with(SE2(1.0, 0.5, 0.3)))
    assert estimate.theta == SE2.identity()
