import math

import cv2
import numpy as np
import pytest
from pytest import approx

from rendezvous.alignment.estimate import Identity
from rendezvous.alignment.frame_error import pose_difference
from rendezvous.alignment.window import OCCUPIED_CELL, MapWindow
from rendezvous.baselines.orb import _GREYS as GREYS
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


class Paired(OrbRansac):
    """ORB whose matches are given: points of map 0, and those of map 1 moved, some to anywhere."""

    def __init__(self, right: int, wrong: int) -> None:
        super().__init__()
        rng = np.random.default_rng(1)
        p_0 = rng.uniform(-4.0, 4.0, (right + wrong, 2))
        p_1 = SE2(0.5, -0.3, 0.4) @ p_0
        p_1[right:] += rng.uniform(3.0, 5.0, (wrong, 2))
        object.__setattr__(self, "pairs", (p_0, p_1))

    def _matches(self, window: MapWindow) -> tuple[np.ndarray, np.ndarray]:
        return self.pairs  # type: ignore[attr-defined]


def test_the_confidence_is_opencvs():
    """Inliers over 8 and three tenths of the matches."""
    window = window_with(SE2.identity())
    assert Paired(14, 6)(window).theta.as_array() == approx([0.5, -0.3, 0.4])
    assert Paired(13, 7)(window).reason == "confidence 0.93; at least 1 is needed"
    assert Paired(6, 0)(window).reason == "confidence 0.61; at least 1 is needed"
    assert Paired(5, 0)(window).reason == "5 matches; at least 6 are needed"


def test_features_lie_about_the_middle_of_the_window():
    """A map turned by a half turn has every feature on the other side of it."""
    house = window_with(SE2.identity()).cells[0]
    p_0, p_1 = OrbRansac()._matches(MapWindow(cells=np.stack([house, house[::-1, ::-1]]), cell_m=0.05))
    assert len(p_0) > 50
    assert np.median(p_0 + p_1, axis=0) == approx([0.0, 0.0], abs=0.02)


def test_a_pair_of_features_that_passes_from_either_side_counts(monkeypatch: pytest.MonkeyPatch):
    window = window_with(SE2.identity())
    same = MapWindow(cells=window.cells[[0, 0]], cell_m=window.cell_m)
    answers = iter([[(0, 0), (3, 4)], [(4, 3), (7, 2)]])
    monkeypatch.setattr(OrbRansac, "_nearest", lambda self, features, others: next(answers))
    points, _ = cv2.ORB.create(nfeatures=500).detectAndCompute(GREYS[same.cells[0]], None)
    at_m = (np.array([point.pt for point in points]) - 191.5) * 0.05
    p_0, p_1 = OrbRansac()._matches(same)
    assert p_0 == approx(at_m[[0, 2, 3]])
    assert p_1 == approx(at_m[[0, 7, 4]])
