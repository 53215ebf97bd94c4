"""Free scenes: any pose in range of the camera, things apart from the robot, all of it recorded."""

import json
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from rendezvous.rendering.appearance.textures import texture_pool
from rendezvous.rendering.draws import PoseDraws
from rendezvous.rendering.free_scenes import (
    PHOTO_SIZES_PX,
    T_W_C,
    draw_free,
    draw_photo_camera,
    draw_photo_pose,
    draw_pose,
)
from rendezvous.rendering.randomise import ROBOT
from rendezvous.robot_file import load_robot
from tests.rendering.one_part import one_part_looks

BURGER = load_robot("burger")
CAMERA = BURGER.camera.intrinsics()
LOOKS = one_part_looks()
DRAWS = PoseDraws()
POOL = texture_pool(np.random.default_rng(0), variants=1, size_px=64)


@cache
def _drawn(seed):
    return draw_free(np.random.default_rng(seed), LOOKS, CAMERA, POOL, DRAWS, variants=1)


def _centre_c(T_w_r1):
    return (np.linalg.inv(T_W_C) @ T_w_r1 @ np.array([*BURGER.cuboid.centre_m, 1.0]))[:3]


def test_poses_are_rigid_in_range_and_in_or_near_the_image():
    rng = np.random.default_rng(0)
    poses = [draw_pose(rng, BURGER, CAMERA, DRAWS) for _ in range(300)]
    centres_c = np.array([_centre_c(pose) for pose in poses])
    ranges_m = np.linalg.norm(centres_c, axis=1)
    uv_px = CAMERA.project(centres_c)
    inside = CAMERA.in_image(uv_px)
    assert (ranges_m > DRAWS.min_range_m - 1e-9).all()
    assert (ranges_m < DRAWS.max_range_m + 1e-9).all()
    assert all(np.allclose(T[:3, :3] @ T[:3, :3].T, np.eye(3)) for T in poses)
    assert all(np.linalg.det(T) == pytest.approx(1.0) for T in poses)
    assert 0.75 < inside.mean() < 1.0
    assert np.histogram(ranges_m, bins=4, range=(DRAWS.min_range_m, DRAWS.max_range_m))[0].min() > 45


def test_most_robots_stand_up_in_the_image_and_some_lie_in_any_way():
    rng = np.random.default_rng(1)
    poses = np.array([draw_pose(rng, BURGER, CAMERA, DRAWS) for _ in range(400)])
    up_w = poses[:, 2, 2]
    assert 0.75 < (up_w > 0.5).mean() < 0.9
    assert (up_w < 0.0).mean() > 0.05
    # The camera looks along x: those that stand are seen from above.
    assert (poses[up_w > 0.5, 0, 2] < 0.1).mean() > 0.85


def test_things_are_apart_from_the_robot_and_the_camera():
    seen = 0
    for record in (_drawn(seed).record for seed in range(10)):
        centre_w = (np.array(record["T_w_r1"]) @ np.array([*BURGER.cuboid.centre_m, 1.0]))[:3]
        for placed in record["things"]:
            seen += 1
            T_w_t, height_m = np.array(placed["T_w_t"]), placed["thing"]["height_m"]
            middle_w = T_w_t[:3, 3] + 0.5 * height_m * T_w_t[:3, 2]
            reach_m = np.hypot(placed["thing"]["radius_m"], 0.5 * height_m)
            robot_m = 0.5 * np.linalg.norm(BURGER.cuboid.size_m)
            assert np.linalg.norm(middle_w - centre_w) >= reach_m + robot_m - 1e-9
            assert np.linalg.norm(middle_w - T_W_C[:3, 3]) > reach_m
    assert seen >= 15


def test_half_of_the_robots_have_a_ground_under_their_wheels():
    scenes = [_drawn(seed).scene for seed in range(20)]
    grounds = [
        (quad, part)
        for scene in scenes
        for quad in scene.instances
        for part in scene.instances
        if quad.name == "ground" and part.name == f"{ROBOT}/shell"
    ]
    assert 5 <= len(grounds) <= 15
    for quad, part in grounds:
        assert quad.T_w[:3, 2] == pytest.approx(part.T_w[:3, 2])
        assert quad.T_w[:3, 3] == pytest.approx(part.T_w[:3, 3])
        assert 1.0 <= np.linalg.norm(quad.T_w[:3, 0]) <= 6.0


def test_equal_rngs_give_equal_scenes_and_the_record_is_json():
    again = draw_free(np.random.default_rng(3), LOOKS, CAMERA, POOL, DRAWS, variants=1)
    assert json.dumps(again.record) == json.dumps(_drawn(3).record)
    assert np.array_equal(again.scene.background, _drawn(3).scene.background)
    assert json.dumps(again.record) != json.dumps(_drawn(4).record)


def test_a_robot_that_is_absent_is_not_in_the_scene():
    always = replace(DRAWS, absent_share=1.0)
    absent = [draw_free(np.random.default_rng(i), LOOKS, CAMERA, POOL, always, variants=1) for i in range(3)]
    for drawn in absent:
        assert drawn.record["absent"]
        assert drawn.T_w_r1 is None
        assert drawn.T_c_o(BURGER.cuboid) is None
        assert drawn.scene.robot is None
        assert not [x for x in drawn.scene.instances if x.name.startswith(f"{ROBOT}/")]


def test_photographs_are_taken_from_above_with_many_lenses_and_sizes():
    rng = np.random.default_rng(0)
    cameras = [draw_photo_camera(rng) for _ in range(200)]
    assert {(c.width_px, c.height_px) for c in cameras} == set(PHOTO_SIZES_PX)
    widths_deg = np.degrees([2.0 * np.arctan(0.5 * c.width_px / c.fx_px) for c in cameras])
    assert 45.0 <= widths_deg.min() < 50.0 < 85.0 < widths_deg.max() <= 90.0
    assert all(c.cx_px == 0.5 * (c.width_px - 1) and c.fx_px == c.fy_px for c in cameras)
    poses = np.array([draw_photo_pose(rng, BURGER, c) for c in cameras])
    # The camera looks along x: the robot's up axis leans towards it by as much as it is seen from above.
    above_deg = np.degrees(np.arcsin(-poses[:, 0, 2]))
    assert 9.0 < above_deg.min() < 14.0
    assert 36.0 < above_deg.max() < 41.0
    assert np.ptp(np.degrees(np.arctan2(poses[:, 1, 0], poses[:, 1, 1]))) > 300.0


def test_photographs_show_the_robot_from_far_to_beyond_the_frame():
    rng = np.random.default_rng(1)
    shares = []
    for _ in range(200):
        camera = draw_photo_camera(rng)
        T_w_r1 = draw_photo_pose(rng, BURGER, camera)
        centre_c = _centre_c(T_w_r1)
        shares.append(camera.fy_px * BURGER.size_m[2] / np.linalg.norm(centre_c) / camera.height_px)
        assert camera.in_image(camera.project(centre_c[None]))[0]
    assert 0.1 < min(shares) < 0.16
    assert max(shares) > 1.0
    assert 0.2 < np.median(shares) < 0.8


def test_the_share_of_photographs_is_the_given_one_and_they_have_their_own_cameras():
    drawn = [
        draw_free(np.random.default_rng(i), LOOKS, CAMERA, POOL, replace(DRAWS, photo_share=s), variants=1)
        for s in (0.0, 1.0)
        for i in range(12)
    ]
    assert all(d.scene.camera == CAMERA for d in drawn[:12])
    assert all(d.record["background"]["style"] == "any" for d in drawn[:12])
    assert all(d.scene.camera.fx_px != CAMERA.fx_px for d in drawn[12:])
    assert {d.record["background"]["style"] for d in drawn[12:]} == {"any", "busy", "white"}
    for one in drawn[12:]:
        size = one.scene.camera.height_px, one.scene.camera.width_px
        assert one.scene.background.shape[:2] == size
        assert one.record["camera"]["fx_px"] == one.scene.camera.fx_px
