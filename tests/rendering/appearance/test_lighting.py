"""Lamps hang in the room, shine where they aim, and cast shadows on request."""

import numpy as np
import pytest

from rendezvous.rendering.appearance.lighting import Lamp, free_lighting, room_lighting
from rendezvous.rendering.scene import LightKind

PLACES_M = np.array([[1.0, 1.0], [2.0, 1.0], [3.0, 2.0]])


def _room(seed, *, shadow):
    return room_lighting(np.random.default_rng(seed), places_m=PLACES_M, ceiling_m=2.5, shadow=shadow)


def _free(seed, *, shadow):
    return free_lighting(np.random.default_rng(seed), target_m=np.array([2.0, 0.0, 1.0]), shadow=shadow)


@pytest.mark.parametrize("draw", [_room, _free])
@pytest.mark.parametrize("seed", range(12))
def test_one_lamp_throws_shadows_if_asked_and_none_else(draw, seed):
    assert sum(lamp.casts_shadow for lamp in draw(seed, shadow=True).lamps) == 1
    assert sum(lamp.casts_shadow for lamp in draw(seed, shadow=False).lamps) == 0


@pytest.mark.parametrize("seed", range(12))
def test_lamps_of_a_room_hang_under_its_ceiling_and_shine_down(seed):
    lighting = _room(seed, shadow=seed % 2 == 0)
    for lamp in lighting.lamps:
        assert lamp.aim[2] < -0.3
        if lamp.kind is not LightKind.DIRECTIONAL:
            assert 1.8 < lamp.xyz_m[2] < 2.5
            assert np.linalg.norm(PLACES_M - lamp.xyz_m[:2], axis=1).min() == 0.0
            assert lamp.reach_m == lamp.xyz_m[2]
    assert 0.0 < min(lighting.ambient_rgb) <= max(lighting.ambient_rgb) < 1.0


@pytest.mark.parametrize(("draw", "brightest"), [(_room, 1.1), (_free, 1.4)])
def test_the_lamps_of_a_scene_share_its_brightness(draw, brightest):
    totals = []
    for lighting in (draw(seed, shadow=False) for seed in range(60)):
        lamps = [lamp for lamp in lighting.lamps if draw is _free or lamp.kind is not LightKind.DIRECTIONAL]
        totals.append(sum(lamp.brightness for lamp in lamps))
        # The sun adds its own.
        assert len(lamps) >= len(lighting.lamps) - 1
        assert all(lamp.reach_m == 1.0 for lamp in lighting.lamps if lamp.kind is LightKind.DIRECTIONAL)
    assert 0.35 <= min(totals) < 0.45
    assert 0.85 * brightest < max(totals) <= brightest


@pytest.mark.parametrize("aim", [(0.0, 0.0, -1.0), (1.0, 0.0, 0.0), (0.6, 0.0, 0.8), (-0.36, 0.48, -0.8)])
def test_a_light_shines_along_its_minus_z_axis(aim):
    lamp = Lamp(
        kind=LightKind.SPOT, xyz_m=(1.0, 2.0, 3.0), aim=aim, temperature_k=4000.0, brightness=0.5, reach_m=2.0
    )
    T_w = lamp.light().T_w
    assert -T_w[:3, 2] == pytest.approx(aim)
    assert T_w[:3, :3].T @ T_w[:3, :3] == pytest.approx(np.eye(3))
    assert np.linalg.det(T_w) == pytest.approx(1.0)


def test_a_lamp_is_as_bright_at_its_reach_as_it_says():
    def luminance(reach_m):
        light = Lamp(
            kind=LightKind.POINT, xyz_m=(0.0, 0.0, reach_m), aim=(0.0, 0.0, -1.0), temperature_k=3000.0,
            brightness=0.4, reach_m=reach_m,
        ).light()  # fmt: skip
        return light.intensity / reach_m**2 / np.pi * (np.array([0.2126, 0.7152, 0.0722]) @ light.colour_rgb)

    assert luminance(1.0) == pytest.approx(0.4)
    assert luminance(2.5) == pytest.approx(0.4)


def test_the_temperature_of_all_light_lies_among_the_lamps():
    for seed in range(30):
        lighting = _free(seed, shadow=False)
        temperatures_k = [lamp.temperature_k for lamp in lighting.lamps]
        assert min(temperatures_k) - 1e-6 <= lighting.temperature_k() <= max(temperatures_k) + 1e-6
