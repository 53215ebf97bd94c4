"""Readings that are none, and clocks that jump."""

import numpy as np
import pytest

from rendezvous.recorded.repair import no_echo_above, readings, rising_stamps


def test_readings_beyond_the_range_are_no_echo_and_impossible_ones_no_measurement():
    given = np.array([[0.0, -1.0, np.nan, np.inf, -np.inf, 0.04, 0.05001, 8.0, 7.99]])
    cleaned = readings(given, range_min_m=0.05, range_max_m=8.0)
    nan, inf = np.nan, np.inf
    np.testing.assert_array_equal(cleaned, [[nan, nan, nan, inf, nan, nan, 0.05001, inf, 7.99]])


def test_readings_piled_up_at_the_end_are_no_echo():
    rng = np.random.default_rng(0)
    echoes = rng.uniform(0.5, 12.0, 5000)
    assert no_echo_above(np.concatenate([echoes, np.full(100, 81.83), [81.91]])) == pytest.approx(
        0.99 * 81.91
    )
    assert no_echo_above(echoes) == np.inf
    assert no_echo_above(np.full(4, np.nan)) == np.inf


def test_stamps_written_out_of_order_are_sorted():
    kept, t_s, notes = rising_stamps(np.array([0.0, 1.0, 2.4, 2.0, 3.0, 4.0, 5.0]))
    assert kept.tolist() == [0, 1, 3, 2, 4, 5, 6]
    assert t_s.tolist() == [0.0, 1.0, 2.0, 2.4, 3.0, 4.0, 5.0]
    assert notes == []


def test_a_clock_that_was_set_back_goes_on_at_its_usual_pace():
    kept, t_s, notes = rising_stamps(np.array([100.0, 101.0, 102.0, 52.0, 53.0, 54.0]))
    assert kept.tolist() == list(range(6))
    assert t_s.tolist() == [100.0, 101.0, 102.0, 103.0, 104.0, 105.0]
    assert notes == ["the clock jumps back by 50 s; what follows is shifted"]


def test_repeated_and_missing_stamps_are_left_out():
    kept, t_s, notes = rising_stamps(np.array([0.0, 1.0, 1.0, np.nan, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0]))
    assert kept.tolist() == [0, 1, 4, 5, 6, 7, 8, 9, 10]
    assert (np.diff(t_s) > 0.0).all()
    assert notes == ["1 scans without a stamp are left out", "1 scans with the stamp of another are left out"]


def test_where_stamps_mean_nothing_order_stands_for_time():
    kept, t_s, notes = rising_stamps(np.zeros(4))
    assert kept.tolist() == [0, 1, 2, 3]
    assert t_s.tolist() == [0.0, 1.0, 2.0, 3.0]
    assert notes == ["the stamps of its 4 scans do not rise; a scan each 1 s is assumed"]
