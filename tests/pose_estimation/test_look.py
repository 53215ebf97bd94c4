from __future__ import annotations

import numpy as np
import pytest

from rendezvous.pose_estimation.look import Look

POINT_PX = np.array([210.3, 155.7])


def _blob(sigma_px: float = 6.0) -> np.ndarray:
    """A normal blob around a point of a black image."""
    v, u = np.mgrid[:480, :640]
    away_px2 = (u - POINT_PX[0]) ** 2 + (v - POINT_PX[1]) ** 2
    return np.repeat(
        (255.0 * np.exp(-0.5 * away_px2 / sigma_px**2)).round().astype(np.uint8)[..., None], 3, 2
    )


@pytest.mark.parametrize("scale", [0.15, 0.37, 0.5, 0.9, 1.0, 2.3])
@pytest.mark.parametrize("beside_px", [(0.0, 0.0), (7.25, -4.9)])
def test_a_look_shows_a_point_where_it_says(scale: float, beside_px: tuple[float, float]):
    look = Look.at(POINT_PX + beside_px, scale=scale, width_px=160, height_px=128)
    shown = look.cut(_blob())[..., 0].astype(float)
    assert shown.shape == (128, 160)
    v, u = np.mgrid[:128, :160]
    centroid_px = np.array([(u * shown).sum(), (v * shown).sum()]) / shown.sum()
    assert centroid_px == pytest.approx(look.to_input(POINT_PX), abs=0.04)


def test_the_middle_of_a_look_is_the_point_that_it_is_at():
    look = Look.at(POINT_PX, scale=0.7, width_px=160, height_px=128)
    assert look.to_input(POINT_PX) == pytest.approx([79.5, 63.5])
    uv_px = np.random.default_rng(0).uniform(-100.0, 700.0, (5, 9, 2))
    assert look.to_image(look.to_input(uv_px)) == pytest.approx(uv_px)


def test_a_look_that_makes_things_smaller_skips_nothing():
    image = np.zeros((480, 640, 3), np.uint8)
    image[::8] = 255
    shown = Look.at(np.array([320.0, 240.0]), scale=0.125, width_px=64, height_px=48).cut(image)
    assert np.abs(shown.astype(float) - 255.0 / 8.0).max() < 3.0


def test_what_lies_beyond_the_image_is_black():
    white = np.full((480, 640, 3), 255, np.uint8)
    for scale in (0.5, 2.0):
        shown = Look.at(np.array([-0.5, 240.0]), scale=scale, width_px=64, height_px=64).cut(white)
        assert not shown[:, :31].any()
        assert (shown[:, 33:] == 255).all()
