"""The weights that come with the project, used as `evaluate` uses them."""

from __future__ import annotations

import math

import numpy as np
import pytest

from rendezvous.alignment.frame_error import pose_difference
from rendezvous.alignment.window import SearchRange
from rendezvous.geometry.se2 import SE2
from rendezvous.models.matcher_calibration import MatcherCalibration
from rendezvous.models.matcher_estimator import MatcherEstimator
from rendezvous.stages.weights.trained_estimators import Trained, load
from tests.baselines.windows import real_window, window_with
from tests.conftest import ROOT

WEIGHTS = ROOT / "assets" / "weights" / "matcher.safetensors"
SEARCH = SearchRange.covering(xy_m=2.0, yaw_rad=math.pi / 4)


@pytest.fixture(scope="module")
def matcher() -> Trained:
    return load(WEIGHTS.read_bytes(), "matcher", SEARCH, where=str(WEIGHTS), threads=1)


def _drawn(seed: int) -> tuple[SE2, float]:
    """A frame error (uniform in ±2 m, ±45°) and a turn of the window."""
    rng = np.random.default_rng([17, seed])
    return SE2(*rng.uniform(-2.0, 2.0, 2), rng.uniform(-math.pi / 4, math.pi / 4)), rng.uniform(-3.0, 3.0)


def test_they_are_small() -> None:
    assert WEIGHTS.stat().st_size < 20e6


@pytest.mark.parametrize("plan", range(4))
def test_they_align_maps_of_buildings_of_another_kind(matcher: Trained, plan: int) -> None:
    theta, turn_rad = _drawn(plan)
    estimate = matcher.estimator(window_with(theta, plan=plan, turn_rad=turn_rad))
    assert estimate.theta is not None
    error = pose_difference(estimate.theta, theta).wrapped()
    assert math.hypot(error.x_m, error.y_m) < 0.15
    assert abs(error.yaw_rad) < math.radians(2.0)


@pytest.mark.slow
def test_they_agree_with_the_registration_of_the_real_pair_from_almost_everywhere(
    real_data, matcher: Trained
) -> None:
    agree = []
    for seed in range(60):
        theta, turn_rad = _drawn(seed)
        estimate = matcher.estimator(real_window(real_data, theta, turn_rad=turn_rad))
        assert estimate.theta is not None
        error = pose_difference(estimate.theta, theta).wrapped()
        agree.append(math.hypot(error.x_m, error.y_m) < 0.3 and abs(error.yaw_rad) < math.radians(3.0))
    assert sum(agree) >= 57


def test_they_are_calibrated(matcher: Trained) -> None:
    assert isinstance(matcher.estimator, MatcherEstimator)
    calibration = matcher.estimator.calibration
    assert calibration != MatcherCalibration()
    assert matcher.record["calibrated_on"]["pairs"] >= 200
