"""Path-traced pictures beside rasterised ones of the same scenes; skipped where Blender is not installed."""

from __future__ import annotations

import sys
from dataclasses import replace
from importlib.util import find_spec

import cv2
import numpy as np
import pytest

from rendezvous.errors import PipelineError, SetupError
from rendezvous.geometry.camera import Image
from rendezvous.rendering.cycles.blender import check_blender
from rendezvous.rendering.cycles.renderer import CyclesRenderer
from rendezvous.rendering.opengl.renderer import Renderer
from rendezvous.rendering.scene import Light, LightKind
from tests.rendering.scenes import (
    CAMERA,
    CHECKED,
    GREY,
    WHITE,
    crowded_scene,
    facing_x,
    looking_down,
    placed,
    pool,
    scene_of,
    sun,
    textures,
)

TILTED = facing_x()
TILTED[:3, :3] = cv2.Rodrigues(np.array([0.2, -0.1, 0.3]))[0] @ TILTED[:3, :3]
FLOOR = placed("quad", (0.0, 0.0, 0.0), size_m=(20.0, 20.0, 1.0), name="floor", material=WHITE)


@pytest.fixture(scope="session")
def cycles() -> CyclesRenderer:
    if find_spec("bpy") is None:
        pytest.skip("needs the extra pathtraced")
    return CyclesRenderer(pool(), textures(), samples=4)


def light(image: Image) -> np.ndarray:
    """Linear, 0..1."""
    return (image / 255.0) ** 2.2


@pytest.mark.parametrize("stretch", [1.0, 1.3])
def test_what_a_pixel_shows_is_what_its_label_says(
    renderer: Renderer, cycles: CyclesRenderer, stretch: float
):
    # Pixels that are higher than wide and, stretched, wider than high.
    camera = replace(CAMERA, fy_px=CAMERA.fy_px * stretch)
    corners_px = np.array([(12.0, 9.0), (195.0, 14.0), (9.0, 131.0), (190.0, 128.0), (100.5, 71.0)])
    rays_c = np.column_stack([corners_px, np.ones(5)]) @ np.linalg.inv(camera.K()).T
    corners_w = rays_c @ TILTED[:3, :3].T + TILTED[:3, 3]
    markers = [placed("marker", tuple(corner_w), size_m=(0.02, 0.02, 0.02)) for corner_w in corners_w]
    scene = scene_of(*markers, camera=camera, T_w_c=TILTED, ambient_rgb=(1.0, 1.0, 1.0))
    ids, rgb = renderer.render(scene).instance_ids, cycles.render(scene)
    shown = rgb[..., 0].astype(float)
    v, u = np.indices(ids.shape)
    for i, corner_px in enumerate(corners_px):
        near = np.hypot(u - corner_px[0], v - corner_px[1]) < 9.0
        for weight in (shown * near, ids == i):
            centre_px = np.array([(u * weight).sum(), (v * weight).sum()]) / weight.sum()
            assert centre_px == pytest.approx(corner_px, abs=0.2)
    assert np.count_nonzero(shown > 127.5) == pytest.approx(np.count_nonzero(ids >= 0), rel=0.1)


def test_a_scene_gives_the_same_bytes_whatever_was_drawn_before(cycles: CyclesRenderer):
    first = crowded_scene(np.random.default_rng(1), boxes=8)
    before = cycles.render(first)
    cycles.render(crowded_scene(np.random.default_rng(2), boxes=5))
    assert np.array_equal(cycles.render(first), before)


def _above(kind: LightKind, intensity: float) -> Light:
    T_w = sun().T_w
    T_w[2, 3] = 2.0
    return Light(kind=kind, T_w=T_w, intensity=intensity)


@pytest.mark.parametrize(
    ("lights", "ambient"),
    [
        ((_above(LightKind.DIRECTIONAL, 0.5 * np.pi),), 0.0),
        ((_above(LightKind.POINT, 2.0 * np.pi),), 0.0),
        ((_above(LightKind.SPOT, 2.0 * np.pi),), 0.0),
        ((), 0.5),
    ],
    ids=["sun", "point", "spot", "ambient"],
)
def test_each_lamp_is_as_bright_as_when_rasterised(
    renderer: Renderer, cycles: CyclesRenderer, lights, ambient
):
    above = {"T_w_c": looking_down(height_m=1.0), "lights": lights, "ambient_rgb": (ambient,) * 3}
    scene = scene_of(replace(FLOOR, material=GREY), **above)
    rasterised, traced = light(renderer.render(scene).rgb), light(cycles.render(scene))
    assert 0.05 < rasterised.mean() < 0.5
    # The rasteriser adds what a matt surface mirrors of ambient light, a twenty-fifth of it, to the rest.
    assert traced.mean() == pytest.approx(rasterised.mean(), rel=0.1)
    assert np.abs(cv2.blur(traced, (9, 9)) - cv2.blur(rasterised, (9, 9))).max() < 0.05


def test_a_crowded_scene_is_about_as_bright_as_when_rasterised(renderer: Renderer, cycles: CyclesRenderer):
    scene = crowded_scene(np.random.default_rng(7), boxes=12)
    assert cycles.render(scene).mean() == pytest.approx(renderer.render(scene).rgb.mean(), rel=0.2)


def test_textures_uvs_and_colours_lie_where_they_do_when_rasterised(
    renderer: Renderer, cycles: CyclesRenderer
):
    scene = scene_of(
        replace(FLOOR, material=CHECKED),
        placed("box", (0.8, -0.3, 0.1), size_m=(0.3, 0.2, 0.4), yaw_rad=0.4, material=CHECKED),
        placed("poster", (0.5, 0.15, 0.02), size_m=(0.2, 0.2, 1.0), material=None),
        placed("coloured", (0.5, -0.1, 0.02), size_m=(0.2, 0.2, 1.0)),
        T_w_c=looking_down(height_m=0.9),
        ambient_rgb=(0.9, 0.9, 0.9),
    )
    scene = replace(scene, T_w_c=scene.T_w_c + np.eye(4, k=3) * 0.5)
    rasterised, traced = renderer.render(scene).rgb, cycles.render(scene)
    assert np.corrcoef(rasterised.ravel(), traced.ravel())[0, 1] > 0.97


def test_the_background_shows_where_nothing_stands(cycles: CyclesRenderer):
    background = np.full((CAMERA.height_px, CAMERA.width_px, 3), (10, 120, 230), np.uint8)
    scene = scene_of(placed("marker", (1.0, 0.0, 0.12), size_m=(0.1, 0.1, 0.1)), background=background)
    assert cycles.render(scene)[0, 0].tolist() == [10, 120, 230]


def test_a_sheet_that_is_seen_from_behind_is_not_there(cycles: CyclesRenderer):
    ball = placed("marker", (0.0, 0.0, 0.5), size_m=(0.1, 0.1, 0.1))
    below = looking_down(height_m=1.0)
    below[:3, :3] = below[:3, :3] @ np.diag([1.0, -1.0, -1.0])
    below[2, 3] = -1.0
    bare, hidden = (
        cycles.render(scene_of(ball, *floor, T_w_c=below, ambient_rgb=(0.5, 0.5, 0.5)))
        for floor in ((), (FLOOR,))
    )
    assert np.array_equal(bare, hidden)
    assert bare.max() > 100


def test_ambient_light_comes_in_through_the_ceiling(cycles: CyclesRenderer):
    ceiling = placed("quad", (0.0, 0.0, 2.0), size_m=(20.0, -20.0, -1.0), name="ceiling")
    shown = cycles.render(scene_of(FLOOR, ceiling, ambient_rgb=(0.1, 0.1, 0.1)))
    assert light(shown[-20:]).mean() > 0.1


def test_a_mesh_or_texture_that_is_not_there_is_named(cycles: CyclesRenderer):
    with pytest.raises(PipelineError, match=r"no mesh 'sofa' in the pool: box, cylinder"):
        cycles.render(scene_of(placed("sofa", (1.0, 0.0, 0.0))))
    with pytest.raises(PipelineError, match=r"no texture 'tartan' in the pool of 2 textures"):
        cycles.render(scene_of(placed("box", (1.0, 0.0, 0.0), material=replace(CHECKED, texture="tartan"))))


def test_without_blender_one_line_names_the_extra(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setitem(sys.modules, "bpy", None)
    told = r"^render.engine cycles needs bpy, which is not installed; `pip install '.*\[pathtraced\]'`"
    with pytest.raises(SetupError, match=told):
        check_blender()
