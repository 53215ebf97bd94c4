"""The camera's flaws: bounded, repeatable, and labels stay true under them."""

from dataclasses import asdict, replace

import numpy as np
import pytest

from rendezvous.errors import PipelineError
from rendezvous.rendering.appearance.colour import (
    LUMINANCE,
    blackbody_rgb,
    linear_from_srgb,
    srgb_from_linear,
)
from rendezvous.rendering.effects import (
    CameraEffects,
    apply_effects,
    draw_effects,
    exposure_gain,
    motion_kernel,
    normal_of,
    sensor_noise,
    tone_curve,
)

SHAPE = (120, 160, 3)


def _blob(u_px, v_px):
    v, u = np.mgrid[: SHAPE[0], : SHAPE[1]]
    value = 60.0 + 150.0 * np.exp(-0.5 * ((u - u_px) ** 2 + (v - v_px) ** 2) / 6.0**2)
    return np.repeat(np.round(value).astype(np.uint8)[..., None], 3, axis=2)


def _centroid_px(image, u_px, v_px):
    """Centroid of what is brighter than its surroundings, near where the blob should be."""
    v, u = np.mgrid[: SHAPE[0], : SHAPE[1]]
    near = np.hypot(u - u_px, v - v_px) < 25.0
    grey = image.mean(axis=2)
    weight = np.where(near, np.maximum(grey - np.median(grey[near]) - 15.0, 0.0), 0.0)
    return np.array([(weight * u).sum(), (weight * v).sum()]) / weight.sum()


@pytest.mark.parametrize(
    "changed",
    [
        {"exposure_ev": 0.8},
        {"exposure_ev": -1.0},
        {"balance_k": 3000.0},
        {"motion_blur_px": 7.0, "motion_blur_rad": 0.4},
        {"motion_blur_px": 6.0, "motion_blur_rad": 2.5},
        {"defocus_px": 1.4},
        {"jpeg_quality": 35},
        {"vignetting": 0.4},
        {"contrast": 1.2, "saturation": 0.7},
        {"shot_noise": 0.02, "read_noise": 0.004, "noise_seed": 8},
    ],
)
def test_effects_leave_things_where_they_are(changed):
    u_px, v_px = 81.3, 58.6
    seen = apply_effects(_blob(u_px, v_px), CameraEffects(**changed))
    assert np.abs(_centroid_px(seen, u_px, v_px) - (u_px, v_px)).max() < 0.1


def test_the_centroid_sees_a_shift_of_a_fifth_of_a_pixel():
    assert np.abs(_centroid_px(_blob(81.5, 58.6), 81.3, 58.6) - (81.3, 58.6)).max() > 0.15


def test_equal_seeds_give_equal_noise_and_others_do_not():
    noisy = CameraEffects(shot_noise=0.03, noise_seed=1)
    first, again = apply_effects(_blob(80, 60), noisy), apply_effects(_blob(80, 60), noisy)
    other = apply_effects(_blob(80, 60), replace(noisy, noise_seed=2))
    assert np.array_equal(first, again)
    assert not np.array_equal(first, other)


def test_the_image_given_is_left_as_it_was():
    image = _blob(80, 60)
    apply_effects(image, draw_effects(np.random.default_rng(2), light_k=3000.0))
    assert np.array_equal(image, _blob(80, 60))


def test_drawn_effects_can_be_applied_and_written_as_json():
    rng = np.random.default_rng(0)
    for _ in range(50):
        effects = draw_effects(rng, light_k=float(rng.uniform(2500, 8000)))
        seen = apply_effects(_blob(80, 60), effects)
        assert seen.shape == SHAPE
        assert seen.dtype == np.uint8
        assert all(type(value) in (int, float, type(None)) for value in asdict(effects).values())


def test_noise_has_the_variance_that_it_claims():
    grey, chroma = sensor_noise(CameraEffects(noise_seed=3), 400, 500)
    draws = np.array([normal_of(word) for word in grey.ravel()[:100000]])
    assert grey.shape == (400, 500)
    assert chroma.shape == (200, 250, 2)
    assert draws.mean() == pytest.approx(0.0, abs=0.02)
    assert draws.std() == pytest.approx(1.0, abs=0.02)


def test_darkness_has_read_noise_only_and_light_has_more():
    noisy = CameraEffects(shot_noise=0.05, noise_seed=4)
    dark = apply_effects(np.zeros(SHAPE, np.uint8), noisy)
    light = apply_effects(np.full(SHAPE, 120, np.uint8), noisy)
    assert dark.std() == 0.0
    assert light.std() > 3.0


def test_automatic_exposure_brings_dim_and_bright_scenes_together():
    dim, bright = (apply_effects(np.full(SHAPE, v, np.uint8), CameraEffects()).mean() for v in (80, 190))
    assert bright == pytest.approx(dim, abs=3.0)


def test_automatic_exposure_changes_brightness_by_at_most_three():
    dark, bright = (exposure_gain(np.full(SHAPE, v, np.float32), CameraEffects()) for v in (0.001, 1.0))
    assert (dark, bright) == (pytest.approx(3.0), pytest.approx(1.0 / 3.0))
    assert exposure_gain(np.full(SHAPE, 0.2, np.float32), CameraEffects()) == pytest.approx(1.2)


def test_contrast_turns_the_tone_curve_about_middle_grey():
    plain, steep = tone_curve(1.0).astype(int), tone_curve(1.2).astype(int)
    for code, changed in ((128, 128), (178, 188), (78, 68), (250, 255)):
        assert np.unique(steep[plain == code]) == pytest.approx([changed], abs=0.5)


def test_without_saturation_colours_become_grey_and_keep_their_luminance():
    coloured = np.full(SHAPE, (200, 80, 40), np.uint8)
    grey = apply_effects(coloured, CameraEffects(saturation=0.0))
    assert np.ptp(grey, axis=2).max() == 0
    luminances = [
        (linear_from_srgb(i[0, 0] / 255.0) * LUMINANCE).sum()
        for i in (grey, apply_effects(coloured, CameraEffects()))
    ]
    assert luminances[0] == pytest.approx(luminances[1], rel=0.03)


@pytest.mark.parametrize("light_k", [2700.0, 8000.0])
def test_white_balance_follows_the_light_part_of_the_way(light_k: float):
    rng = np.random.default_rng(6)
    mired = [1e6 / draw_effects(rng, light_k=light_k).balance_k for _ in range(200)]
    # Normal with a standard deviation of 14.
    assert np.mean(mired) == pytest.approx(0.6e6 / light_k + 0.4e6 / 6504.0, abs=5.0)


def test_a_stop_doubles_the_light():
    grey = np.full(SHAPE, 100, np.uint8)
    one, two = (
        linear_from_srgb(apply_effects(grey, CameraEffects(exposure_ev=ev)) / 255.0).mean()
        for ev in (0.0, 1.0)
    )
    assert two == pytest.approx(2.0 * one, rel=0.03)


def test_light_that_is_taken_for_white_comes_out_grey():
    coded = srgb_from_linear(0.2 * blackbody_rgb(3500.0) / blackbody_rgb(6504.0))
    lit = np.broadcast_to(np.round(255.0 * coded).astype(np.uint8), SHAPE)
    balanced = apply_effects(np.ascontiguousarray(lit), CameraEffects(balance_k=3500.0))
    assert np.ptp(balanced.mean(axis=(0, 1))) < 4.0
    assert np.ptp(lit.mean(axis=(0, 1))) > 40.0


def test_corners_are_darker_by_the_share_lost():
    grey = np.full(SHAPE, 120, np.uint8)
    seen = linear_from_srgb(apply_effects(grey, CameraEffects(vignetting=0.4)) / 255.0)
    assert seen[0, 0, 0] / seen[60, 80, 0] == pytest.approx(0.6, abs=0.02)


@pytest.mark.parametrize("angle_rad", [0.0, 0.7, 1.9, 3.0])
def test_motion_blur_spreads_along_its_direction_and_weighs_one(angle_rad):
    kernel = motion_kernel(CameraEffects(motion_blur_px=6.0, motion_blur_rad=angle_rad))
    radius = kernel.shape[0] // 2
    v, u = np.mgrid[-radius : radius + 1, -radius : radius + 1]
    along = np.average((u * np.cos(angle_rad) + v * np.sin(angle_rad)) ** 2, weights=kernel)
    across = np.average((v * np.cos(angle_rad) - u * np.sin(angle_rad)) ** 2, weights=kernel)
    assert kernel.sum() == pytest.approx(1.0, abs=1e-5)
    # Variance of a uniform path of 6 px: 6 ** 2 / 12, some of it beyond the kernel.
    assert along == pytest.approx(3.0, abs=0.9)
    assert across < 0.4


def test_hot_bodies_are_blue_and_cool_ones_red():
    temperatures_k = np.array([1900.0, 2700.0, 4000.0, 6504.0, 9000.0, 15000.0])
    colours = np.array([blackbody_rgb(t) for t in temperatures_k])
    assert (np.diff(colours[:, 2] / colours[:, 0]) > 0.0).all()
    assert colours @ LUMINANCE == pytest.approx(np.ones(6))
    assert colours[3] == pytest.approx(np.ones(3), abs=0.06)


def test_the_transfer_curve_and_its_inverse_agree():
    coded = np.linspace(0.0, 1.0, 256)
    assert srgb_from_linear(linear_from_srgb(coded)) == pytest.approx(coded, abs=1e-5)


def test_negative_noise_is_refused():
    with pytest.raises(PipelineError, match=r"shot_noise is -0\.1; must be from 0"):
        CameraEffects(shot_noise=-0.1)
