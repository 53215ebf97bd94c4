from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rendezvous.pose_estimation.dope_labels import belief_maps
from rendezvous.pose_estimation.peaks import belief_peaks

CELLS = 20


def drawn(*points: tuple[float, float], sigma: float = 1.0) -> np.ndarray:
    """(9, 20, 20): all points in channel 3, given in cells."""
    uv = np.full((len(points), 9, 2), np.nan)
    uv[:, 3] = points
    return belief_maps(8.0 * uv, width_px=8 * CELLS, height_px=8 * CELLS, stride_px=8, sigma_cells=sigma)


@settings(max_examples=100, deadline=None)
@given(u=st.floats(2.0, 17.99), v=st.floats(2.0, 17.99))
def test_a_drawn_point_comes_back_wherever_it_lies(u, v):
    peaks = belief_peaks(drawn((u, v)), sigma_cells=1.0)
    assert peaks.channel_P.tolist() == [3]
    assert peaks.uv_cells_P2[0] == pytest.approx((u, v), abs=0.02)
    assert peaks.height_P[0] == pytest.approx(1.0, abs=0.02)


@pytest.mark.parametrize("blur", [0.5, 1.0])
def test_a_blurred_point_stays_where_it_is_but_is_lower(blur):
    rows, cols = np.mgrid[0:CELLS, 0:CELLS]
    width = 1.0 + blur**2
    maps = np.exp(-0.5 * ((cols - 7.3) ** 2 + (rows - 9.6) ** 2) / width)[None].astype(np.float32) / width
    peaks = belief_peaks(maps, sigma_cells=1.0)
    assert peaks.uv_cells_P2[0] == pytest.approx((7.3, 9.6), abs=0.025)
    assert 1.0 / width < peaks.height_P[0] < 1.0


def test_noise_moves_a_peak_little():
    rng = np.random.default_rng(0)
    points = rng.uniform(3.0, 17.0, (200, 2))
    errors = []
    for point in points:
        noisy = drawn(tuple(point)) + rng.normal(0.0, 0.02, (9, CELLS, CELLS)).astype(np.float32)
        peaks = belief_peaks(noisy, sigma_cells=1.0, least_height=0.3)
        errors.append(peaks.uv_cells_P2[0] - point)
    # The best that can be done with noise ε on a Gaussian of σ = 1 and height 1 is ε √(2 / π).
    assert 0.015 < np.std(errors) < 0.03
    assert abs(np.mean(errors)) < 0.005


def test_several_peaks_of_a_map_come_the_highest_first():
    maps = drawn((5.2, 5.4), (12.7, 9.1))
    maps[3, 8:12, 10:16] *= 0.6
    maps[5] = 0.5 * drawn((8.0, 8.0))[3]
    peaks = belief_peaks(maps, sigma_cells=1.0)
    assert peaks.channel_P.tolist() == [3, 3, 5]
    assert peaks.uv_cells_P2 == pytest.approx(np.array([(5.2, 5.4), (12.7, 9.1), (8.0, 8.0)]), abs=0.1)
    assert peaks.height_P == pytest.approx([1.0, 0.6, 0.5], abs=0.05)
    assert belief_peaks(maps, sigma_cells=1.0, most=1).channel_P.tolist() == [3, 5]


def test_two_equal_cells_side_by_side_are_one_peak_between_them():
    maps = np.zeros((1, CELLS, CELLS), np.float32)
    maps[0, 7, 7:9] = 0.8
    peaks = belief_peaks(maps, sigma_cells=1.0)
    assert peaks.uv_cells_P2 == pytest.approx(np.array([[7.5, 7.0]]), abs=0.05)


def test_flat_maps_have_no_peaks():
    assert len(belief_peaks(np.zeros((9, CELLS, CELLS), np.float32), sigma_cells=1.0).height_P) == 0
    low = np.full((9, CELLS, CELLS), 0.04, np.float32)
    assert len(belief_peaks(low, sigma_cells=1.0).height_P) == 0


def test_a_maximum_on_the_border_is_read_there():
    maps = np.zeros((1, CELLS, CELLS), np.float32)
    maps[0, 0, 10], maps[0, 0, 9], maps[0, 0, 11], maps[0, 1, 10] = 0.8, 0.5, 0.5, 0.5
    peaks = belief_peaks(maps, sigma_cells=1.0)
    assert peaks.uv_cells_P2[0, 0] == pytest.approx(10.0, abs=1e-6)
    assert -0.75 <= peaks.uv_cells_P2[0, 1] <= 0.75
