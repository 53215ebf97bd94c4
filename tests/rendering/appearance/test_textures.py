"""Textures tile, are what their rng says, and look like surfaces rather than noise."""

import numpy as np
import pytest

from rendezvous.rendering.appearance.textures import KINDS, texture_key, texture_pool

SIZE_PX = 128


def _jump(image, axis):
    """Mean step across the seam, and the greatest mean step between neighbouring lines within."""
    steps = np.abs(image.astype(float) - np.roll(image.astype(float), 1, axis=axis))
    per_line = steps.mean(axis=tuple(i for i in range(3) if i != axis))
    return per_line[0], per_line[1:].max()


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("axis", [0, 1])
def test_a_texture_has_no_seam(kind, axis):
    image = KINDS[kind].make(np.random.default_rng(3), SIZE_PX) * 255.0
    seam, within = _jump(image, axis)
    # Boards, tiles and books have edges; the seam is no sharper than the sharpest of them.
    assert seam <= 1.15 * within + 1.0


def test_the_test_of_the_seam_sees_a_cut_texture():
    image = KINDS["concrete"].make(np.random.default_rng(3), SIZE_PX)[:, : SIZE_PX // 2 + 7] * 255.0
    seam, within = _jump(image, 1)
    assert seam > 1.15 * within + 1.0


def test_equal_rngs_give_equal_pools_and_others_do_not():
    first, again, other = (texture_pool(np.random.default_rng(s), variants=1, size_px=64) for s in (5, 5, 6))
    assert first.keys() == again.keys() == other.keys()
    assert all(np.array_equal(first[key], again[key]) for key in first)
    assert not any(np.array_equal(first[key], other[key]) for key in first)


def test_more_kinds_before_it_leave_no_variant_equal_to_another():
    pool = texture_pool(np.random.default_rng(0), variants=2, size_px=64)
    assert not any(np.array_equal(pool[texture_key(kind, 0)], pool[texture_key(kind, 1)]) for kind in KINDS)


@pytest.mark.parametrize("kind", KINDS)
def test_a_texture_is_an_image_of_its_size_in_range(kind):
    image = KINDS[kind].make(np.random.default_rng(1), SIZE_PX)
    assert image.shape == (SIZE_PX, SIZE_PX, 3)
    assert image.dtype == np.float32
    assert np.isfinite(image).all()
    assert (image.mean() > 0.05) & (image.mean() < 0.97)


@pytest.mark.parametrize("kind", [name for name, kind in KINDS.items() if kind.neutral])
def test_neutral_textures_are_light_grey(kind):
    image = KINDS[kind].make(np.random.default_rng(1), SIZE_PX)
    assert np.ptp(image, axis=2).max() == 0.0
    assert image.mean() > 0.6
