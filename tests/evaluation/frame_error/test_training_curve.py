from __future__ import annotations

import json

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
    ("position_m", "converged"),
    [
        (1.0 / SAMPLES, False),
        (0.1 + np.exp(-SAMPLES), True),
        (np.full(20, 0.1) + 0.002 * (-1.0) ** SAMPLES, True),
        (0.1 * np.exp(-0.02 * SAMPLES), False),
        (0.1 * np.exp(-0.004 * SAMPLES), True),
        ([0.1, 0.1, 0.1], None),
    ],
)
def test_a_row_whose_error_still_falls_has_not_converged(position_m, converged: bool | None):
    assert _curve(position_m).converged is converged


@pytest.mark.parametrize("points", [8, 20])
def test_one_point_that_an_outlier_raises_decides_nothing(points: int):
    """One of 48 pairs off by 2.4 m adds 0.05 m to the mean."""
    for falling, converged in ((0.0, True), (0.8, False)):
        smooth = 0.1 * (1.0 - falling * np.arange(points) / points)
        for outlier in range(points):
            assert _curve(smooth + 0.05 * (np.arange(points) == outlier)).converged is converged


def test_heading_counts_as_well():
    assert _curve(np.full(20, 0.1), yaw_rad=1.0 / SAMPLES).converged is False


def test_a_curve_is_that_of_its_points_and_survives_json():
    before = _curve([0.4, 0.2])
    assert before.samples.tolist() == [100.0, 200.0]
    assert before.position_m == approx([0.4, 0.2])
    assert before.minutes == approx(0.2)
    after = TrainingCurve.from_json(json.loads(json.dumps(before.to_json())))
    assert after.to_json() == before.to_json()


def test_of_a_run_without_points_nothing_is_known():
    assert TrainingCurve.from_points([]).converged is None


def test_words_say_what_speaks_against_a_row():
    assert doubt(None) == doubt(_curve([0.1])) == "convergence not known"
    assert doubt(_curve(1.0 / SAMPLES)) == "not converged"
    assert doubt(_curve(np.full(20, 0.1))) == ""
