from __future__ import annotations

import hashlib
import multiprocessing
import subprocess
import sys
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from itertools import product

import cv2
import numpy as np
import psutil
import pytest

from rendezvous.errors import PipelineError, SetupError
from rendezvous.geometry.camera import PinholeCamera
from rendezvous.geometry.se2 import Array
from rendezvous.rendering.opengl import gl
from rendezvous.rendering.opengl.renderer import Renderer
from rendezvous.rendering.scene import NO_INSTANCE, Light, LightKind, Material, Scene
from tests.rendering.golden import GOLDEN, golden_scene
from tests.rendering.scenes import (
    CAMERA,
    CHECKED,
    GREY,
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


def projected(p_w: Array, T_w_c: Array, camera: PinholeCamera = CAMERA) -> Array:
    """(N, 2) by OpenCV, which knows nothing of our projection."""
    T_c_w = np.linalg.inv(T_w_c)
    rotation, _ = cv2.Rodrigues(T_c_w[:3, :3])
    return cv2.projectPoints(p_w, rotation, T_c_w[:3, 3], camera.K(), None)[0].reshape(-1, 2)


@pytest.mark.parametrize("T_w_c", [facing_x(), TILTED], ids=["level", "tilted"])
def test_markers_at_a_cuboids_corners_are_seen_where_they_project(renderer: Renderer, T_w_c: Array):
    corners_c = np.array([[x, y, z] for x, y, z in product((-0.15, 0.15), (-0.1, 0.1), (0.6, 0.8))])
    corners_w = corners_c @ T_w_c[:3, :3].T + T_w_c[:3, 3]
    expected_px = projected(corners_w, T_w_c)
    for corner_w, uv_px in zip(corners_w, expected_px, strict=True):
        marker = placed("marker", tuple(corner_w), size_m=(0.005, 0.005, 0.005))
        rgb = renderer.render(scene_of(marker, T_w_c=T_w_c)).rgb.astype(float).sum(axis=2)
        v, u = np.indices(rgb.shape)
        seen_px = np.array([(u * rgb).sum(), (v * rgb).sum()]) / rgb.sum()
        assert np.abs(seen_px - uv_px).max() < 0.1


def slab_hits(scene: Scene) -> tuple[np.ndarray, np.ndarray]:
    """(H, W) nearest box and its depth, by intersecting every pixel's ray with every box in numpy."""
    camera = scene.camera
    v, u = np.indices((camera.height_px, camera.width_px)).astype(float)
    rays_c = np.stack([(u - camera.cx_px) / camera.fx_px, (v - camera.cy_px) / camera.fy_px, np.ones_like(u)])
    ids, depth_m = np.full(u.shape, NO_INSTANCE), np.full(u.shape, np.inf)
    for i, instance in enumerate(scene.instances):
        T_b_c = np.linalg.inv(instance.T_w) @ scene.T_w_c
        direction = np.einsum("ij,jhw->ihw", T_b_c[:3, :3], rays_c)
        with np.errstate(divide="ignore"):
            ends = (np.array([-0.5, 0.5])[:, None, None, None] - T_b_c[:3, 3][:, None, None]) / direction
        enter, leave = ends.min(axis=0).max(axis=0), ends.max(axis=0).min(axis=0)
        nearer = (enter < leave) & (enter > 0.0) & (enter < depth_m)
        ids[nearer], depth_m[nearer] = i, enter[nearer]
    return ids, depth_m


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_ids_depth_and_visibility_agree_with_rays_cast_in_numpy(renderer: Renderer, seed: int):
    crowded = crowded_scene(np.random.default_rng(seed), boxes=25)
    robot = placed("box", (1.5, 0.1, 0.1), size_m=(0.2, 0.2, 0.2), yaw_rad=0.4, name="r1")
    boxes = tuple(instance for instance in crowded.instances if instance.mesh == "box")
    scene = replace(crowded, instances=(robot, *boxes), T_w_c=TILTED)
    rendering = renderer.render(scene)
    ids, depth_m = slab_hits(scene)
    assert (rendering.instance_ids == ids).mean() > 0.999
    same = (rendering.instance_ids == ids) & (ids != NO_INSTANCE)
    np.testing.assert_allclose(rendering.depth_m[same], depth_m[same], rtol=2e-4)
    assert np.isinf(rendering.depth_m[rendering.instance_ids == NO_INSTANCE]).all()
    alone, _ = slab_hits(replace(scene, instances=(robot,)))
    view = renderer.robot_view(scene, rendering)
    assert view.visibility == pytest.approx((ids == 0).sum() / (alone == 0).sum(), abs=0.02)


def test_what_is_hidden_to_the_half_is_half_visible(renderer: Renderer):
    robot = placed("box", (1.0, 0.0, 0.12), size_m=(0.01, 0.3, 0.2), name="r1")
    screen = placed("box", (0.8, 0.5, 0.12), size_m=(0.01, 1.0, 1.0))
    scene = scene_of(robot, screen, robot="r1")
    view = renderer.robot_view(scene, renderer.render(scene))
    assert view.visibility == pytest.approx(0.5, abs=0.02)
    corners_w = np.array([[0.995, -0.15, 0.02], [0.995, 0.0, 0.22]])
    (x1, y1), (x0, y0) = projected(corners_w, scene.T_w_c)
    assert view.box_px == pytest.approx((x0, y0, x1, y1), abs=1.0)


@pytest.mark.parametrize(("u_px", "v_px"), [(-0.5, 71.0), (207.5, 71.0), (100.5, -0.5), (100.5, 143.5)])
def test_what_lies_half_outside_the_image_is_half_visible(renderer: Renderer, u_px: float, v_px: float):
    y_m, z_m = -(u_px - CAMERA.cx_px) / CAMERA.fx_px, 0.12 - (v_px - CAMERA.cy_px) / CAMERA.fy_px
    robot = placed("box", (1.0, y_m, z_m), size_m=(1e-3, 0.2, 0.2), name="r1")
    scene = scene_of(robot, robot="r1")
    assert renderer.robot_view(scene, renderer.render(scene)).visibility == pytest.approx(0.5, abs=0.03)


def test_a_silhouette_larger_than_the_image_is_counted_whole(renderer: Renderer):
    robot = placed("box", (0.5, 0.0, 0.12), size_m=(1e-4, 1.2, 0.8), name="r1")
    scene = scene_of(robot, robot="r1")
    area_px = 1.2 * 0.8 / 0.5**2 * CAMERA.fx_px * CAMERA.fy_px
    assert renderer.silhouette_px(scene) == pytest.approx(area_px, rel=0.01)


def test_an_absent_robot_has_no_box_and_visibility_0(renderer: Renderer):
    behind = placed("box", (-3.0, 0.0, 0.1), name="r1")
    for scene in (scene_of(placed("box", (2.0, 0.0, 0.1))), scene_of(behind, robot="r1")):
        view = renderer.robot_view(scene, renderer.render(scene))
        assert (view.visibility, view.box_px, view.visible_px) == (0.0, None, 0)


def brightness(renderer: Renderer, material: Material, **fields: object) -> float:
    """Linear, of a large level surface seen from above."""
    floor = placed("quad", (0.0, 0.0, 0.0), size_m=(9.0, 9.0, 1.0), material=material)
    scene = scene_of(floor, T_w_c=looking_down(height_m=1.0), ambient_rgb=(0.0, 0.0, 0.0), **fields)
    return float((renderer.render(scene).rgb[72, 100] / 255.0).mean() ** 2.2)


def test_a_matt_surface_sends_back_its_share_of_parallel_light(renderer: Renderer):
    for intensity, slant in ((1.0, 0.0), (2.0, 0.0), (2.0, 1.0)):
        got = brightness(renderer, GREY, lights=(sun(towards=(slant, 0.0, -1.0), intensity=intensity),))
        lambert = 0.3 / np.pi * intensity / np.hypot(1.0, slant)
        assert got == pytest.approx(lambert, rel=0.1)  # the rest is the sheen of a dielectric


def test_light_of_a_point_falls_with_the_square_of_its_distance(renderer: Renderer):
    def at(height_m: float) -> float:
        T_w = np.eye(4)
        T_w[2, 3] = height_m
        return brightness(renderer, GREY, lights=(Light(kind=LightKind.POINT, T_w=T_w, intensity=8.0),))

    assert at(1.5) / at(3.0) == pytest.approx(4.0, rel=0.06)


def test_a_spot_lights_its_cone_alone(renderer: Renderer):
    T_w = np.eye(4)
    T_w[:3, 3] = 0.0, 0.0, 2.0
    spot = Light(kind=LightKind.SPOT, T_w=T_w, intensity=8.0, cone_rad=np.arctan(0.15))
    floor = placed("quad", (0.0, 0.0, 0.0), size_m=(9.0, 9.0, 1.0))
    scene = scene_of(floor, T_w_c=looking_down(height_m=1.0), ambient_rgb=(0.0, 0.0, 0.0), lights=(spot,))
    lit = renderer.render(scene).rgb.max(axis=2) > 0
    rows, columns = np.flatnonzero(lit.any(axis=1)), np.flatnonzero(lit.any(axis=0))
    radius_px = 0.5 * np.array([np.ptp(rows) / CAMERA.fy_px, np.ptp(columns) / CAMERA.fx_px])
    assert radius_px == pytest.approx([0.3, 0.3], abs=0.02)


@pytest.mark.parametrize("kind", [LightKind.DIRECTIONAL, LightKind.SPOT])
def test_a_shadow_lies_where_the_light_is_blocked(renderer: Renderer, kind: LightKind):
    T_w = np.eye(4)
    T_w[2, 3] = 3.0
    light = Light(kind=kind, T_w=T_w, intensity=5.0, casts_shadow=True, cone_rad=1.0)
    floor = placed("quad", (0.0, 0.0, 0.0), size_m=(9.0, 9.0, 1.0))
    # A plate above the camera: its shadow is seen, itself not.
    plate = placed("box", (0.0, 0.0, 1.5), size_m=(0.2, 0.2, 0.01))
    scene = scene_of(floor, plate, T_w_c=looking_down(height_m=1.4), lights=(light,), ambient_rgb=(0.1,) * 3)
    side_m = 0.2 if kind is LightKind.DIRECTIONAL else 0.4
    unshadowed = replace(scene, lights=(replace(light, casts_shadow=False),))
    bare = renderer.render(unshadowed).rgb[:, :, 0].astype(float)
    dark = renderer.render(scene).rgb[:, :, 0] < 0.75 * bare
    expected_px = (side_m / 1.4) ** 2 * CAMERA.fx_px * CAMERA.fy_px
    assert dark.sum() == pytest.approx(expected_px, rel=0.12)
    u_px, v_px = projected(np.zeros((1, 3)), scene.T_w_c)[0]
    rows, columns = np.nonzero(dark)
    assert (columns.mean(), rows.mean()) == pytest.approx((u_px, v_px), abs=1.0)


@pytest.mark.parametrize(("lifted_m", "darker"), [(0.0, True), (0.5, False)])
def test_the_ground_is_darker_under_a_robot_that_stands_on_it(
    renderer: Renderer, lifted_m: float, darker: bool
):
    floor = placed("quad", (0.0, 0.0, 0.0), size_m=(9.0, 9.0, 1.0))
    robot = placed("box", (0.7, 0.0, 0.1 + lifted_m), size_m=(0.2, 0.2, 0.2), name="r1")
    rgb, plain = (
        renderer.render(scene_of(floor, robot, robot=name)).rgb[:, :, 0].astype(int) for name in ("r1", None)
    )
    u_px, v_px = np.round(projected(np.array([[0.59, 0.0, 0.0]]), facing_x())[0]).astype(int)
    assert (rgb[v_px, u_px] < plain[v_px, u_px] - 5) == darker
    # Not so a robot's width away.
    u_px, v_px = np.round(projected(np.array([[0.55, 0.0, 0.0]]), facing_x())[0]).astype(int)
    assert rgb[v_px, u_px] == plain[v_px, u_px]
    assert (rgb <= plain).all()


def test_an_empty_scene_is_black(renderer: Renderer):
    rendering = renderer.render(scene_of())
    assert not rendering.rgb.any()
    assert (rendering.instance_ids == NO_INSTANCE).all()


@pytest.mark.parametrize("mesh", ["box", "quad"])
@pytest.mark.parametrize("side_m", [0.7, 3.0])
def test_a_texture_keeps_its_scale_however_a_mesh_is_stretched(renderer: Renderer, mesh: str, side_m: float):
    board = placed(mesh, (0.0, 0.0, 0.0), size_m=(side_m, side_m, 1e-3), material=CHECKED)
    rgb = renderer.render(scene_of(board, T_w_c=looking_down(height_m=1.0))).rgb
    row = rgb[72 + 6, 100 - 60 : 100 + 60, 0] > 60
    steps_px = np.diff(np.flatnonzero(np.diff(row.astype(int))))
    assert steps_px.mean() == pytest.approx(0.125 * CAMERA.fx_px, rel=0.02)


def test_a_mesh_without_a_material_given_wears_its_own_colour(renderer: Renderer):
    board = placed("painted", (0.0, 0.0, 0.0), material=None)
    pixel = renderer.render(scene_of(board, T_w_c=looking_down(height_m=1.0))).rgb[72, 100] / 255.0
    red, green, blue = pixel**2.2
    sheen = blue  # of a dielectric, the same in all channels
    assert (green - sheen) / (red - sheen) == pytest.approx(0.2, abs=0.02)


def test_colours_of_vertices_are_srgb(renderer: Renderer):
    look = {"T_w_c": looking_down(height_m=1.0)}
    half = Material(base_colour_rgb=3 * ((128.0 / 255.0) ** 2.2,))
    coloured, plain = (
        renderer.render(scene_of(placed(mesh, (0.0, 0.0, 0.0), material=material), **look)).rgb[72, 100, 0]
        for mesh, material in (("coloured", None), ("quad", half))
    )
    assert int(coloured) == pytest.approx(int(plain), abs=1)


def test_a_mesh_with_uvs_and_a_picture_of_its_own_shows_it_once(renderer: Renderer):
    board = placed("poster", (0.0, 0.0, 0.0), size_m=(0.5, 0.5, 1.0), material=None)
    scene = scene_of(board, T_w_c=looking_down(height_m=1.0))
    rendering = renderer.render(scene)
    red = np.argwhere(rendering.rgb[:, :, 0] > 150)[:, ::-1]
    # Its u runs along x, which is up in this image.
    expected_px = projected(np.array([[-0.25, 0.25, 0.0], [0.0, -0.25, 0.0]]), scene.T_w_c)
    assert red.min(axis=0) == pytest.approx(expected_px.min(axis=0), abs=2.0)
    assert red.max(axis=0) == pytest.approx(expected_px.max(axis=0), abs=2.0)


def test_the_border_of_two_colours_in_one_plane_is_smooth(renderer: Renderer):
    left = placed("quad", (0.0, -0.5, 0.0), name="left", material=GREY)
    right = placed("quad", (0.0, 0.5, 0.0), name="right")
    tilted = looking_down(height_m=1.0) @ np.array(
        [[0.98, -0.199, 0, 0], [0.199, 0.98, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]
    )
    row = renderer.render(scene_of(left, right, T_w_c=tilted)).rgb[60:90, 80:120, 0].astype(int)
    between = (row > row.min() + 5) & (row < row.max() - 5)
    assert between.any(axis=1).mean() > 0.5


def test_the_background_shows_wherever_nothing_stands(renderer: Renderer):
    background = np.random.default_rng(0).integers(0, 256, (144, 208, 3), dtype=np.uint8)
    scene = scene_of(placed("box", (2.0, 0.0, 0.1), size_m=(0.3, 0.3, 0.3)), background=background)
    rendering = renderer.render(scene)
    inside = cv2.dilate((rendering.instance_ids != NO_INSTANCE).astype(np.uint8), np.ones((3, 3))) > 0
    assert 0 < inside.sum() < inside.size
    np.testing.assert_array_equal(rendering.rgb[~inside], background[~inside])


def test_an_outline_is_smooth_between_dark_and_bright(renderer: Renderer):
    scene = scene_of(placed("box", (1.0, 0.0, 0.1), size_m=(0.2, 0.2, 0.2)), T_w_c=TILTED)
    levels = np.unique(renderer.render(scene).rgb[:, :, 0])
    np.testing.assert_allclose(levels, np.linspace(0.0, levels[-1], 5), atol=1.0)


def test_what_was_drawn_before_leaves_no_trace(renderer: Renderer):
    first, second = (crowded_scene(np.random.default_rng(seed)) for seed in (0, 1))
    before = renderer.render(first)
    renderer.robot_view(second, renderer.render(second))
    after = renderer.render(first)
    np.testing.assert_array_equal(before.rgb, after.rgb)
    np.testing.assert_array_equal(before.instance_ids, after.instance_ids)


def _digest(renderer: Renderer | None, seed: int) -> str:
    """SHA-256 of a rendering, by a renderer of its own if None is given."""
    drawn = (renderer or Renderer(pool(), textures())).render(crowded_scene(np.random.default_rng(seed)))
    parts = (drawn.rgb, drawn.instance_ids, drawn.depth_m)
    return hashlib.sha256(b"".join(np.ascontiguousarray(part).tobytes() for part in parts)).hexdigest()


def test_two_processes_draw_the_same_bits(renderer: Renderer):
    with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as other:
        elsewhere = other.submit(_digest, None, 3).result()
    assert elsewhere == _digest(renderer, 3) != _digest(renderer, 4)


def test_a_picture_is_that_of_other_machines_but_for_rounding(renderer: Renderer):
    golden = cv2.imread(str(GOLDEN))[:, :, ::-1].astype(int)
    difference = np.abs(renderer.render(golden_scene()).rgb - golden).max(axis=2)
    assert difference.mean() < 0.5
    assert (difference > 8).mean() < 0.005


def test_memory_stays_flat_over_a_hundred_pictures(renderer: Renderer):
    scenes = [crowded_scene(np.random.default_rng(seed), boxes=5 + seed) for seed in range(5)]

    def after(pictures: int) -> int:
        for i in range(pictures):
            renderer.robot_view(scenes[i % 5], renderer.render(scenes[i % 5]))
        return int(psutil.Process().memory_info().rss)

    warm = after(20)
    # Ids, depth and colour of one picture take 0.3 MB.
    assert after(100) - warm < 6e6


def test_one_renderer_draws_images_of_several_sizes(renderer: Renderer):
    """Each as a renderer that has drawn nothing else, and the first again as at first."""
    scene = crowded_scene(np.random.default_rng(5))
    wide = replace(scene, camera=replace(CAMERA, width_px=320, height_px=96, cx_px=159.5, cy_px=47.5))
    first = renderer.render(scene)
    drawn = renderer.render(wide)
    assert drawn.rgb.shape == (96, 320, 3)
    alone = Renderer(pool(), textures()).render(wide)
    np.testing.assert_array_equal(drawn.rgb, alone.rgb)
    np.testing.assert_array_equal(drawn.instance_ids, alone.instance_ids)
    assert renderer.silhouette_px(wide) == Renderer(pool(), textures()).silhouette_px(wide)
    np.testing.assert_array_equal(renderer.render(scene).rgb, first.rgb)


def test_what_is_in_no_pool_is_named(renderer: Renderer):
    with pytest.raises(PipelineError, match="no mesh 'teapot' in the pool: box, "):
        renderer.render(scene_of(placed("teapot", (1.0, 0.0, 0.0))))
    marble = Material(base_colour_rgb=(1.0, 1.0, 1.0), texture="marble")
    with pytest.raises(PipelineError, match="no texture 'marble'"):
        renderer.render(scene_of(placed("box", (1.0, 0.0, 0.0), material=marble)))


def test_the_one_who_draws_has_a_name(renderer: Renderer):
    assert gl.renderer_name()


def test_importing_the_renderer_needs_no_graphics_library():
    code = "import sys, rendezvous.rendering.opengl.renderer; sys.exit('OpenGL' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_a_missing_library_is_one_line_that_says_what_to_install(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(gl, "LIBRARIES", {"libEGL.so.99": "libegl1", "libGL.so.99": "libgl1"})
    with pytest.raises(SetupError) as caught:
        gl.check_libraries()
    message = str(caught.value)
    assert "libEGL.so.99 and libGL.so.99" in message
    assert message.endswith("apt-get install libegl1 libgl1")
    assert "\n" not in message
