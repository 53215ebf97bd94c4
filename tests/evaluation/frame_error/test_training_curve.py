from __future__ import annotations

import numpy as np
import pytest
from pytest import approx

from rendezvous.evaluation.frame_error.training_curve import TrainingCurve, doubt


def _curve(position_m, yaw_rad=None) -> TrainingCurve:
    points = [
        {
            "samples": 100 * (i + 1),
            "elapsed_s": 6.0 * (i + 1),
            "error_x_m": error_m - 0.01,
            "error_y_m": error_m + 0.01,
            "error_yaw_rad": error_m if yaw_rad is None else yaw_rad[i],
        }
        for i, error_m in enumerate(position_m)
    ]
    return TrainingCurve.from_points(points)


SAMPLES = np.arange(1, 21)


@pytest.mark.parametrize(
    ("position_m", "yaw_rad", "converged"),
    [
        (1.0 / SAMPLES, None, False),
        (0.1 + np.exp(-SAMPLES), None, True),
        (np.full(20, 0.1) + 0.002 * (-1.0) ** SAMPLES, None, True),
        (0.1 * np.exp(-0.02 * SAMPLES), None, False),
        (0.1 * np.exp(-0.004 * SAMPLES), None, True),
        (np.full(20, 0.1), 1.0 / SAMPLES, False),
        ([0.1, 0.1, 0.1], None, None),
        ([], None, None),
    ],
)
def test_a_row_whose_error_still_falls_has_not_converged(position_m, yaw_rad, converged: bool | None):
    assert _curve(position_m, yaw_rad).converged is converged


def test_a_curve_is_that_of_its_points():
    curve = _curve([0.4, 0.2])
    assert curve.samples.tolist() == [100.0, 200.0]
    assert curve.position_m == approx([0.4, 0.2])
    assert curve.minutes == approx(0.2)


@pytest.mark.parametrize("points", [8, 20])
def test_one_point_that_an_outlier_raises_decides_nothing(points: int):
    """One of 48 pairs off by 2.4 m adds 0.05 m to the mean."""
    for falling, converged in ((0.0, True), (0.8, False)):
        smooth = 0.1 * (1.0 - falling * np.arange(points) / points)
        for outlier in range(points):
            assert _curve(smooth + 0.05 * (np.arange(points) == outlier)).converged is converged


def test_words_say_what_speaks_against_a_row():
    assert doubt(None) == doubt(_curve([0.1])) == "convergence not known"
    assert doubt(_curve(1.0 / SAMPLES)) == "not converged"
    assert doubt(_curve(np.full(20, 0.1))) == ""
