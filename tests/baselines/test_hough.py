import math

import numpy as np
import pytest
from pytest import approx

from rendezvous.alignment.frame_error import pose_difference
from rendezvous.alignment.window import DEFAULT_SEARCH, FREE_CELL, OCCUPIED_CELL, MapWindow, SearchRange
from rendezvous.baselines.hough import HoughSpectrum, agreement
from rendezvous.geometry.se2 import SE2
from tests.baselines.windows import real_window, window_with, without_walls

IN_RANGE = HoughSpectrum(search=DEFAULT_SEARCH)


def error_of(theta_hat: SE2 | None, theta: SE2) -> tuple[float, float]:
    """Distance [m], angle [degrees]."""
    assert theta_hat is not None
    error = pose_difference(theta_hat, theta)
    return math.hypot(error.x_m, error.y_m), abs(math.degrees(error.yaw_rad))


@pytest.mark.parametrize("seed", range(4))
def test_in_range_it_finds_the_motion_between_maps_of_rooms(seed: int):
    rng = np.random.default_rng(seed)
    theta = SE2(*rng.uniform(-1.4, 1.4, 2), rng.uniform(-math.pi / 4, math.pi / 4))
    window = window_with(theta, plan=seed % 4, turn_rad=rng.uniform(-3.0, 3.0))
    distance_m, angle_deg = error_of(IN_RANGE(window).theta, theta)
    assert distance_m < 0.12
    assert angle_deg < 1.5


def test_everywhere_it_finds_a_map_turned_onto_itself():
    window = window_with(SE2.identity())
    house = window.cells[0]
    moved = np.roll(np.rot90(house, k=1), (12, -8), axis=(0, 1))  # a quarter turn clockwise, seen with y up
    theta_hat = HoughSpectrum()(MapWindow(cells=np.stack([house, moved]), cell_m=0.05)).theta
    assert theta_hat is not None
    assert theta_hat.as_array() == approx([-0.4, 0.6, -math.pi / 2], abs=0.025)  # half a cell


def test_the_robust_variant_also_tries_the_headings_beside_each_candidate():
    window = window_with(SE2(0.3, 0.2, math.radians(9.0)))
    headings_deg = []
    for robust_rad in (0.0, math.radians(1.0)):  # bins of 4 degrees
        theta = HoughSpectrum(search=DEFAULT_SEARCH, directions=90, robust_rad=robust_rad)(window).theta
        assert theta is not None
        headings_deg.append(math.degrees(theta.yaw_rad))
    assert headings_deg == approx([8.0, 9.0])


def test_agreement_counts_the_cells_that_both_maps_know():
    cells = np.zeros((2, 4, 4), np.uint8)
    cells[0, 0, :3] = FREE_CELL, OCCUPIED_CELL, FREE_CELL
    cells[1, 0, 1:] = OCCUPIED_CELL, OCCUPIED_CELL, FREE_CELL
    window = MapWindow(cells=cells, cell_m=0.1)
    assert agreement(window, SE2.identity()) == approx(1 / 2)
    assert agreement(window, SE2(0.1, 0.0, 0.0)) == approx(2 / 3)
    assert agreement(window, SE2(0.0, 0.2, 0.0)) == 0.0


def test_outside_of_its_headings_it_fails_and_says_so():
    narrow = HoughSpectrum(search=SearchRange(xy_m=1.0, yaw_rad=math.radians(3.0)))
    estimate = narrow(window_with(SE2(0.0, 0.0, math.radians(30.0))))
    assert estimate.theta is None
    assert estimate.reason == "the spectra agree at no heading in the range"


@pytest.mark.parametrize("channel", [0, 1])
def test_a_map_without_walls_is_a_failure_that_says_so(channel: int):
    estimate = HoughSpectrum()(without_walls(window_with(SE2.identity()), channel))
    assert estimate.theta is None
    assert estimate.reason == f"map {channel} has no walls in the window"


def test_maps_that_the_range_cannot_bring_together_are_a_failure_that_says_so():
    cells = np.zeros((2, 384, 384), np.uint8)
    cells[0, 40:60, 40] = cells[0, 40, 40:80] = cells[1, 340:360, 340] = cells[1, 340, 300:340] = (
        OCCUPIED_CELL
    )
    estimate = IN_RANGE(MapWindow(cells=cells, cell_m=0.05))
    assert estimate.theta is None
    assert estimate.reason == "no motion that was tried lets both maps agree on any cell"


def test_in_range_it_agrees_with_the_registration_of_the_real_pair(real_data):
    for theta in (SE2(1.0, -0.5, 0.4), SE2(-1.3, 0.9, -0.6), SE2(0.2, 1.4, 0.1)):
        distance_m, angle_deg = error_of(IN_RANGE(real_window(real_data, theta)).theta, theta)
        assert distance_m < 0.3
        assert angle_deg < 3.5


def test_everywhere_it_finds_the_heading_of_the_real_pair_but_for_a_half_turn(real_data):
    """With any heading allowed, it takes one end of the corridor for the other."""
    for theta in (SE2(1.0, -0.5, 0.4), SE2(-1.3, 0.9, -0.6), SE2(0.5, 0.5, 2.5)):
        theta_hat = HoughSpectrum()(real_window(real_data, theta)).theta
        assert theta_hat is not None
        turn_rad = pose_difference(theta_hat, theta).yaw_rad
        assert abs(math.remainder(turn_rad, math.pi)) < math.radians(3.0)


def test_its_names_tell_the_two_apart():
    assert HoughSpectrum().name == "Hough spectrum"
    assert IN_RANGE.name == "Hough spectrum, in range"


def test_its_answer_is_what_it_was_when_it_was_measured():
    estimate = IN_RANGE(window_with(SE2(1.1, -0.6, 0.4), turn_rad=1.0))
    assert estimate.theta.as_array() == approx([1.07343, -0.61052, 0.40143], abs=1e-4)


def test_the_likeliest_candidates_are_tried_each_with_the_headings_beside_it():
    """Spectra that agree at six turns, each less than the one before."""
    spectrum_0 = np.zeros(360)
    spectrum_0[0] = 1.0
    spectrum_1 = np.zeros(360)
    turns_deg = [10, -20, 40, 170, 75, -90]
    spectrum_1[turns_deg] = [6.0, 5.0, 4.0, 3.0, 2.0, 1.0]
    beside = math.radians(1.0)
    everywhere = HoughSpectrum()._headings(spectrum_0, spectrum_1)
    assert everywhere == approx([math.radians(t) + d for t in turns_deg[:4] for d in (0.0, beside, -beside)])
    plain = HoughSpectrum(
        search=SearchRange(xy_m=1.0, yaw_rad=math.radians(90.0)), candidates=9, robust_rad=0.0
    )
    assert plain._headings(spectrum_0, spectrum_1) == approx(np.radians([10, -20, 40, 75, -90]))
