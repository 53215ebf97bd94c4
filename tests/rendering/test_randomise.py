"""Laws of what is drawn: on the floor, in range, repeatable, recorded."""

import json
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import shapely
import trimesh

from rendezvous.errors import FloorplanError
from rendezvous.floorplan.furnish import furnish
from rendezvous.floorplan.records import Shape, Solid
from rendezvous.geometry.camera import camera_pose, se3_from_se2
from rendezvous.geometry.se2 import SE2
from rendezvous.rendering.appearance.textures import KINDS, texture_key
from rendezvous.rendering.draws import PoseDraws
from rendezvous.rendering.plan_scene import draw_room_looks, plan_meshes
from rendezvous.rendering.randomise import (
    ROBOT,
    camera_tilt,
    draw_plausible,
    room_scene,
)
from rendezvous.rendering.robot_family import robot_looks
from rendezvous.rendering.scene import LightKind
from rendezvous.rendering.thing_meshes import thing_meshes
from rendezvous.rendering.viewpoints import draw_robot_poses, furnished_plan
from rendezvous.robot_file import load_robot
from tests.floorplan.plans import generated, plan_of
from tests.rendering.one_part import one_part_looks

BURGER = load_robot("burger")
VARIANTS = 2
DRAWS = PoseDraws()
LOOKS = one_part_looks()
MESHES = {**plan_meshes(), **thing_meshes()}
TEXTURES = {texture_key(kind, i) for kind in KINDS for i in range(VARIANTS)}


@cache
def _place(index=0):
    plan = generated(index)
    furniture = furnish(plan, np.random.default_rng(index), density=1.0, robot_radius_m=BURGER.radius_m)
    return furnished_plan(plan, furniture, wall_height_m=2.5)


@cache
def _drawn(seed):
    return draw_plausible(
        np.random.default_rng(seed), _place(seed % 2), LOOKS, BURGER, DRAWS, variants=VARIANTS
    )


def _robot(scene):
    return [instance for instance in scene.instances if instance.name == f"{ROBOT}/shell"]


def _ground_points(instance):
    """(N, 3) [m] in w of the instance's vertices."""
    p = np.concatenate([np.asarray(mesh.vertices) for mesh in MESHES[instance.mesh]])
    return p @ instance.T_w[:3, :3].T + instance.T_w[:3, 3]


SEEDS = range(12)


def test_the_robot_stands_on_free_floor_in_range_and_at_least_at_the_images_edge():
    seen = 0
    for seed in SEEDS:
        scene = _drawn(seed).scene
        for part in _robot(scene):
            seen += 1
            assert part.T_w[2] == pytest.approx([0.0, 0.0, 1.0, 0.0])
            standing = shapely.Point(part.T_w[:2, 3]).buffer(BURGER.radius_m - 0.002)
            assert _place(seed % 2).floor.covers(standing)
            p_c = np.linalg.inv(scene.T_w_c) @ part.T_w @ np.array([*BURGER.cuboid.centre_m, 1.0])
            assert DRAWS.min_range_m - 0.03 <= np.linalg.norm(p_c[:3]) <= DRAWS.max_range_m + 0.03
            u_px = scene.camera.project(p_c[None, :3])[0, 0]
            # Beyond the edge by at most half the robot's width, and what a tilt of the camera adds.
            margin_px = 0.5 * BURGER.size_m[1] * scene.camera.fx_px / p_c[2] + 25.0
            assert -margin_px < u_px < scene.camera.width_px + margin_px
    assert seen >= 10


def test_the_camera_is_where_a_standing_robot_has_it():
    poses = np.array([_drawn(seed).scene.T_w_c for seed in SEEDS])
    assert poses[:, 2, 3] == pytest.approx(BURGER.camera.xyz_m[2], abs=0.02)
    assert np.abs(poses[:, 2, 2]).max() < np.radians(4.0)
    assert all(_place(i % 2).floor.covers(shapely.Point(T[:2, 3])) for i, T in enumerate(poses))
    # Neither height nor tilt is the same twice.
    assert len(set(poses[:, 2, 3])) == len(set(poses[:, 2, 2])) == len(poses)


def test_small_things_stand_on_free_floor_and_touch_no_robot():
    seen = 0
    for seed in SEEDS:
        scene, place = _drawn(seed).scene, _place(seed % 2)
        stand = [part.T_w[:2, 3] for part in _robot(scene)]
        for i in {x.name.split("-")[1] for x in scene.instances if x.name.startswith("thing-")}:
            seen += bool(stand)
            parts = [x for x in scene.instances if x.name.startswith(f"thing-{i}-")]
            p_w = np.concatenate([_ground_points(part) for part in parts])
            hull = shapely.MultiPoint(p_w[:, :2]).convex_hull
            assert p_w[:, 2].min() == pytest.approx(0.0, abs=2e-3)
            assert place.floor.buffer(0.005).covers(hull)
            assert all(hull.distance(shapely.Point(xy_m)) > BURGER.radius_m for xy_m in stand)
    assert seen >= 15


def test_leaves_grow_out_of_their_pots():
    plants = 0
    for seed in range(2):
        solids = {x.name: x for x in _drawn(seed).scene.instances if x.name.split("/")[0].endswith("-plant")}
        for leaf in (x for x in solids.values() if x.mesh == "thing/leaves" and x.name[0].isdigit()):
            (pot,) = (x for name, x in solids.items() if name[:3] == leaf.name[:3] and x is not leaf)
            plants += 1
            assert _ground_points(leaf)[:, 2].min() == pytest.approx(
                _ground_points(pot)[:, 2].max(), abs=1e-6
            )
    assert plants >= 2


def test_equal_rngs_give_equal_scenes_and_others_do_not():
    first, again = (
        draw_plausible(np.random.default_rng(3), _place(), LOOKS, BURGER, DRAWS, variants=VARIANTS)
        for _ in "ab"
    )
    assert json.dumps(first.record) == json.dumps(again.record)
    assert all(
        np.array_equal(a.T_w, b.T_w) and (a.name, a.mesh, a.material) == (b.name, b.mesh, b.material)
        for a, b in zip(first.scene.instances, again.scene.instances, strict=True)
    )
    assert json.dumps(first.record) != json.dumps(_drawn(4).record)


def test_every_key_is_in_the_pools_and_lights_are_within_limits():
    scenes = [_drawn(seed).scene for seed in SEEDS]
    instances = [x for scene in scenes for x in scene.instances]
    assert {x.mesh for x in instances} <= {*MESHES, *map(LOOKS.mesh, LOOKS.parts)}
    assert {x.material.texture for x in instances} - {None} <= TEXTURES
    assert all(1 <= len(scene.lights) <= 4 for scene in scenes)
    assert all(sum(light.casts_shadow for light in scene.lights) <= 1 for scene in scenes)


def test_the_record_holds_what_the_scene_shows():
    drawn = _drawn(5)
    record = json.loads(json.dumps(drawn.record))
    assert record["mode"] == "plausible"
    assert record["effects"]["noise_seed"] == drawn.effects.noise_seed
    assert len(record["lighting"]["lamps"]) == len(drawn.scene.lights)
    floor = next(x for x in drawn.scene.instances if x.name == "floor")
    assert record["surfaces"]["floor"]["texture"] == floor.material.texture
    things = {x.name.split("-")[1] for x in drawn.scene.instances if x.name.startswith("thing-")}
    assert len(record["things"]) == len(things)


def test_shadows_absence_and_edges_come_in_their_shares():
    records = [
        draw_plausible(np.random.default_rng([9, i]), _two_rooms(), LOOKS, BURGER, DRAWS, variants=1).record
        for i in range(150)
    ]
    shadows = np.mean([any(lamp["casts_shadow"] for lamp in r["lighting"]["lamps"]) for r in records])
    absent = np.mean([r["meeting"]["T_w_r1"] is None for r in records])
    # Five standard deviations of the binomial either way.
    assert shadows == pytest.approx(0.25, abs=0.177)
    assert 0.0 < absent < 0.05 + 0.089


@cache
def _two_rooms():
    plan = plan_of([[0.0, 0.0], [6.0, 0.0], [6.0, 5.0], [0.0, 5.0]])
    return furnished_plan(plan, (), wall_height_m=2.5)


def test_distances_and_headings_are_uniform_where_there_is_room():
    rng = np.random.default_rng(0)
    meetings = [draw_robot_poses(rng, _two_rooms(), BURGER, BURGER, DRAWS, absent=False) for _ in range(300)]
    between = [m.T_w_r0.inverse() @ m.T_w_r1 for m in meetings]
    quarter = np.bincount([int(2.0 * (pose.wrapped().yaw_rad / np.pi + 1.0)) % 4 for pose in between])
    far = np.mean([np.hypot(pose.x_m, pose.y_m) > 2.15 for pose in between])
    assert quarter.min() > 45
    # A little under a half: the farther, the fewer places.
    assert 0.38 < far < 0.58


def test_a_plan_too_small_for_two_robots_is_refused():
    closet = furnished_plan(plan_of([[0, 0], [0.3, 0], [0.3, 0.3], [0, 0.3]]), (), wall_height_m=2.5)
    with pytest.raises(FloorplanError, match="no place for two robots"):
        draw_robot_poses(np.random.default_rng(0), closet, BURGER, BURGER, DRAWS, absent=False)


def _cupboard():
    return Solid(
        shape=Shape.BOX, x_m=2.0, y_m=1.8, yaw_rad=0.0, half_x_m=0.3, half_y_m=1.8, z0_m=0.0, z1_m=2.0,
        category="wardrobe", item=0,
    )  # fmt: skip


U_SHAPE = [[0, 0], [1.7, 0], [1.7, 3.6], [2.3, 3.6], [2.3, 0], [4, 0], [4, 4], [0, 4]]
SQUARE = [[0, 0], [4, 0], [4, 4], [0, 4]]


@pytest.mark.parametrize(("outline", "furniture"), [(U_SHAPE, ()), (SQUARE, (_cupboard(),))])
def test_neither_a_wall_nor_a_cupboard_stands_between_the_robots(outline, furniture):
    place, rng = furnished_plan(plan_of(outline), furniture, wall_height_m=2.5), np.random.default_rng(0)
    for _ in range(30):
        poses = draw_robot_poses(rng, place, BURGER, BURGER, DRAWS, absent=False)
        ends_m = np.stack([pose.as_array()[:2] for pose in (poses.T_w_r0, poses.T_w_r1)])
        # The line of sight starts at the camera and may end at a side of the robot.
        reach = shapely.LineString(ends_m).intersection(place.floor.buffer(0.12)).length
        assert reach == pytest.approx(np.linalg.norm(ends_m[1] - ends_m[0]), abs=0.1)


def test_a_camera_beside_the_middle_has_the_robot_in_its_image_all_the_same():
    aside = replace(BURGER, camera=replace(BURGER.camera, xyz_m=(0.1, 0.5, 0.12)))
    rng, intrinsics = np.random.default_rng(2), aside.camera.intrinsics()
    for _ in range(20):
        poses = draw_robot_poses(rng, _two_rooms(), aside, BURGER, DRAWS, absent=False)
        T_w_c = se3_from_se2(poses.T_w_r0) @ aside.camera.T_r_c()
        T_w_o = se3_from_se2(poses.T_w_r1) @ BURGER.cuboid.T_r_o()
        p_c = (np.linalg.inv(T_w_c) @ T_w_o)[:3, 3]
        assert DRAWS.min_range_m <= np.linalg.norm(p_c) <= DRAWS.max_range_m
        margin_px = 0.4 * BURGER.size_m[1] * intrinsics.fx_px / p_c[2]
        assert -margin_px < intrinsics.project(p_c[None])[0, 0] < intrinsics.width_px + margin_px


def test_lamps_hang_in_front_of_the_camera():
    ahead = []
    for T_w_c, lights in ((_drawn(seed).scene.T_w_c, _drawn(seed).scene.lights) for seed in SEEDS):
        hanging = [light.T_w[:2, 3] for light in lights if light.kind is not LightKind.DIRECTIONAL]
        ahead += [(xy_m - T_w_c[:2, 3]) @ T_w_c[:2, 2] for xy_m in hanging]
    assert len(ahead) > 10
    assert min(ahead) > -1e-9


def test_what_occludes_stands_between_the_camera_and_the_robot():
    always = replace(DRAWS, occluded_share=1.0, absent_share=0.0, min_range_m=2.0)
    gaps_m = []
    for i in range(8):
        rng = np.random.default_rng([8, i])
        record = draw_plausible(rng, _two_rooms(), LOOKS, BURGER, always, variants=1).record
        ends_m = np.array(
            [[record["meeting"][r]["x_m"], record["meeting"][r]["y_m"]] for r in ("T_w_r0", "T_w_r1")]
        )
        sight = shapely.LineString(ends_m)
        first = record["things"][0]
        gap_m = sight.distance(shapely.Point(np.array(first["T_w_t"])[:2, 3])) - first["thing"]["radius_m"]
        gaps_m.append(gap_m)
    # Off the line by at most nine tenths of half the robot's width; some have no place there.
    assert np.median(gaps_m) < 0.45 * BURGER.size_m[1]


def test_a_view_with_known_poses_has_the_robot_there():
    place = _two_rooms()
    room_looks = draw_room_looks(np.random.default_rng(0), place, variants=1)
    T_w_r1 = SE2(3.0, 2.0, 0.7)
    drawn = room_scene(
        np.random.default_rng(1), place, room_looks, LOOKS.as_built(), BURGER.camera.intrinsics(), DRAWS,
        T_w_c=se3_from_se2(SE2(1.0, 2.0, 0.0)) @ BURGER.camera.T_r_c(), T_w_r1=T_w_r1,
    )  # fmt: skip
    assert all(np.allclose(part.T_w, se3_from_se2(T_w_r1)) for part in _robot(drawn.scene))
    T_c_r1 = np.linalg.inv(drawn.scene.T_w_c) @ se3_from_se2(T_w_r1)
    assert np.allclose(drawn.T_c_o(BURGER.cuboid), T_c_r1 @ BURGER.cuboid.T_r_o())
    assert drawn.scene.robot == ROBOT
    assert not [x for x in drawn.scene.instances if x.name.startswith("thing-")]


def test_a_robots_parts_become_its_meshes_and_materials():
    grey = trimesh.visual.material.PBRMaterial(baseColorFactor=[0.2, 0.3, 0.4, 1.0], roughnessFactor=0.5)
    part = trimesh.creation.box([0.1, 0.1, 0.1])
    part.visual = trimesh.visual.TextureVisuals(material=grey)
    looks, meshes = robot_looks(BURGER, {"lid": part})
    assert meshes == {"burger/lid": (part,)}
    assert looks.parts["lid"].material.roughness == 0.5
    assert looks.parts["lid"].material.base_colour_rgb == pytest.approx((0.2, 0.3, 0.4), abs=0.005)
    placed = looks.as_built().instances(np.eye(4))
    assert [(x.name, x.mesh) for x in placed] == [("r1/lid", "burger/lid")]


def test_pitch_lowers_the_view_of_a_camera():
    T_w_c = camera_pose(np.zeros(3), np.zeros(3)) @ camera_tilt(0.0, 0.1)
    assert T_w_c[2, 2] == pytest.approx(-np.sin(0.1))
    rolled = camera_pose(np.zeros(3), np.zeros(3)) @ camera_tilt(0.1, 0.0)
    assert rolled[2, 0] == pytest.approx(-np.sin(0.1))
