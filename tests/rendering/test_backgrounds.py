"""Backgrounds have the size asked for, are soft, and show the photos that are given."""

import numpy as np
import pytest

from rendezvous.rendering.appearance.textures import texture_pool
from rendezvous.rendering.backgrounds import (
    BackgroundStyle,
    draw_background,
    photo_background,
    room_background,
)

POOL = texture_pool(np.random.default_rng(0), variants=1, size_px=128)


@pytest.mark.parametrize("seed", range(6))
def test_a_room_background_has_its_size_and_is_neither_black_nor_white(seed):
    image = room_background(np.random.default_rng(seed), POOL, width_px=320, height_px=240)
    assert image.shape == (240, 320, 3)
    assert image.dtype == np.uint8
    assert 30 < image.mean() < 200
    assert image.std() > 5


@pytest.mark.parametrize("seed", range(6))
def test_a_room_background_is_out_of_focus(seed):
    image = room_background(np.random.default_rng(seed), POOL, width_px=320, height_px=240).astype(float)
    # A sharp edge would step over its whole contrast from one pixel to the next.
    assert np.abs(np.diff(image, axis=1)).max() < 0.4 * np.ptp(image)


def test_equal_rngs_give_equal_backgrounds_and_others_do_not():
    first, again, other = (
        room_background(np.random.default_rng(s), POOL, width_px=160, height_px=120) for s in (1, 1, 2)
    )
    assert np.array_equal(first, again)
    assert not np.array_equal(first, other)


@pytest.mark.parametrize("shape", [(90, 400, 3), (700, 500, 3), (50, 50, 3)])
def test_a_cut_of_a_photo_has_the_size_asked_for_and_its_colours(shape):
    photo = np.zeros(shape, np.uint8)
    photo[...] = 10, 120, 230
    cut = photo_background(np.random.default_rng(0), photo, width_px=160, height_px=120)
    assert cut.shape == (120, 160, 3)
    assert (cut == (10, 120, 230)).all()


def test_a_photo_is_cut_without_stretching_it():
    v, u = np.mgrid[:300, :900]
    photo = np.repeat((40.0 + 0.2 * u + 0.05 * v)[..., None], 3, axis=2).astype(np.uint8)
    cut = photo_background(np.random.default_rng(2), photo, width_px=160, height_px=120).astype(float)
    across, down = abs(np.diff(cut[60, :, 0]).mean()), abs(np.diff(cut[:, 80, 0]).mean())
    assert across / down == pytest.approx(4.0, rel=0.15)


def test_half_of_the_cuts_are_mirrored():
    photo = np.repeat(np.tile(np.arange(200, dtype=np.uint8), (150, 1))[..., None], 3, axis=2)
    cuts = [photo_background(np.random.default_rng(s), photo, width_px=40, height_px=30) for s in range(40)]
    rising = np.mean([cut[0, -1, 0] > cut[0, 0, 0] for cut in cuts])
    assert 0.2 < rising < 0.8


def test_photos_are_used_when_there_are_any():
    photos = [np.full((120, 160, 3), value, np.uint8) for value in (50, 90)]
    drawn = [
        draw_background(np.random.default_rng(s), POOL, photos, width_px=160, height_px=120)
        for s in range(20)
    ]
    assert {record["photo"] for _, record in drawn} == {0, 1}
    assert all((image == (50, 90)[record["photo"]]).all() for image, record in drawn)
    image, record = draw_background(np.random.default_rng(0), POOL, (), width_px=16, height_px=16)
    assert record["photo"] is None
    again = room_background(np.random.default_rng(record["seed"]), POOL, width_px=16, height_px=16)
    assert np.array_equal(image, again)


def test_a_white_background_is_nearly_white_even_where_there_are_photos():
    black = [np.zeros((200, 300, 3), np.uint8)]
    for seed in range(10):
        image, record = draw_background(
            np.random.default_rng(seed), POOL, black, width_px=160, height_px=120, style=BackgroundStyle.WHITE
        )
        assert image.shape == (120, 160, 3)
        assert image.min() > 170
        assert np.ptp(image.astype(int), axis=2).max() < 16
        assert record["style"] == "white"


def test_a_busy_background_has_more_edges_than_another():
    def edges(busy: bool) -> float:
        images = [
            room_background(np.random.default_rng(s), POOL, width_px=320, height_px=240, busy=busy)
            for s in range(8)
        ]
        return float(np.mean([np.abs(np.diff(image.astype(float), axis=1)).mean() for image in images]))

    assert edges(True) > 1.5 * edges(False)
