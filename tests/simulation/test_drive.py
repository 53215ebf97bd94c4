import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest
from pytest import approx

from rendezvous.floorplan.records import Solid
from rendezvous.geometry.se2 import SE2, Array
from rendezvous.simulation.drive import TICK_S, Encoder, Nearby, OdometryNoise, Physics, Slots
from rendezvous.simulation.world import Drive, scene_mjcf
from rendezvous.slam.slam import WheelOdometry
from tests.simulation.scenes import burger, pole, wall


def physics(
    *starts: SE2,
    solids: Sequence[Solid] = (),
    drive: Drive = Drive.WHEELS,
    planar_slip: float = 0.0,
    all_solids: bool = False,
) -> Physics:
    specs = [burger() for _ in starts]
    return Physics(
        solids,
        specs,
        starts,
        drive=drive,
        planar_slip=planar_slip,
        rng=np.random.default_rng(0),
        all_solids=all_solids,
    )


def driven(world: Physics, twist: tuple[float, float], seconds: float) -> Array:
    for _ in range(round(seconds / TICK_S)):
        world.step([twist] * len(world.poses_w()))
    return world.poses_w()


def test_the_burger_weighs_what_its_file_says() -> None:
    model = mujoco.MjModel.from_xml_string(scene_mjcf([], [burger()], [SE2.identity()]))
    assert model.body_subtreemass[0] == approx(burger().mass_kg)


@pytest.mark.parametrize("drive", list(Drive))
def test_a_robot_drives_straight_at_the_commanded_speed(drive: Drive) -> None:
    x, y, yaw = driven(physics(SE2(1.0, 2.0, 0.5), drive=drive), (0.2, 0.0), 10.0)[0]
    ahead = SE2(1.0, 2.0, 0.5).inverse() @ SE2(x, y, yaw)
    # Starting up and the tyres' creep cost some centimetres of 2 m, never direction.
    assert ahead.x_m == approx(2.0, abs=0.05)
    assert ahead.y_m == approx(0.0, abs=0.005)
    assert ahead.yaw_rad == approx(0.0, abs=0.005)


@pytest.mark.parametrize("drive", list(Drive))
def test_a_robot_turns_about_the_middle_of_its_wheels(drive: Drive) -> None:
    x, y, yaw = driven(physics(SE2(1.0, 2.0, 0.5), drive=drive), (0.0, 1.5), 10.0)[0]
    assert math.hypot(x - 1.0, y - 2.0) < 0.01
    assert yaw == approx(0.5 + 15.0, rel=0.02)


def test_commands_are_cut_to_the_burgers_limits() -> None:
    spec = burger()
    left, right = spec.wheel_speeds(1.0, 0.0)
    assert left * spec.wheels.radius_m == approx(0.22)
    left, right = spec.wheel_speeds(0.22, 2.84)
    assert max(abs(left), abs(right)) * spec.wheels.radius_m <= 0.22 + 1e-12
    # Scaled together: the arc keeps its curvature.
    speed = 0.5 * spec.wheels.radius_m * (left + right)
    turn = spec.wheels.radius_m * (right - left) / spec.wheels.track_m
    assert turn / speed == approx(2.84 / 0.22)


def test_a_wall_stops_the_robot_but_not_its_wheels() -> None:
    world = physics(SE2.identity(), solids=[wall(0.5, -1.0, 0.5, 1.0)])
    x, _, _ = driven(world, (0.2, 0.0), 10.0)[0]
    front_m = burger().chassis.centre_x_m + burger().chassis.radius_m
    assert x + front_m == approx(0.49, abs=0.02)
    assert world.wheels_rad(0)[0] * burger().wheels.radius_m > 0.9


def test_robots_block_each_other() -> None:
    world = physics(SE2.identity(), SE2(1.0, 0.0, math.pi))
    poses = driven(world, (0.2, 0.0), 15.0)
    assert math.dist(poses[0, :2], poses[1, :2]) > 0.06


@pytest.mark.parametrize("drive", list(Drive))
def test_odometry_follows_a_square_but_not_exactly(drive: Drive) -> None:
    world = physics(SE2.identity(), drive=drive, planar_slip=0.02)
    encoder = Encoder(OdometryNoise(), rng=np.random.default_rng(3))
    spec = burger()
    odometry = WheelOdometry(wheel_radius_m=spec.wheels.radius_m, track_m=spec.wheels.track_m)
    odometry.update(encoder.read((0.0, 0.0)))
    for _ in range(4):
        for twist, seconds in (((0.2, 0.0), 5.0), ((0.0, 0.8), 0.5 * math.pi / 0.8)):
            for _ in range(round(seconds / TICK_S)):
                world.step([twist])
                odometry.update(encoder.read(world.wheels_rad(0)))
    error = odometry.pose() - world.poses_w()[0]
    assert 1e-3 < math.hypot(error[0], error[1]) < 0.3
    assert 1e-3 < abs(error[2]) < 0.3


def test_encoders_read_in_steps_with_a_scale_of_their_own() -> None:
    noise = OdometryNoise(scale_sigma=0.01, jitter_rad=0.0)
    scales = []
    for seed in range(200):
        left, _ = Encoder(noise, rng=np.random.default_rng(seed)).read((1000.0, 1000.0))
        assert (left / noise.tick_rad) == approx(round(left / noise.tick_rad), abs=1e-6)
        scales.append(left / 1000.0)
    assert np.mean(scales) == approx(1.0, abs=0.003)
    assert np.std(scales) == approx(0.01, rel=0.2)


def test_each_wheel_has_a_scale_of_its_own() -> None:
    noise = OdometryNoise(scale_sigma=0.01, jitter_rad=0.0, tick_rad=1e-6)
    scale = 1.0 + 0.01 * np.random.default_rng(7).standard_normal(2)
    read = Encoder(noise, rng=np.random.default_rng(7)).read((1000.0, 2000.0))
    assert read == approx((1000.0 * scale[0], 2000.0 * scale[1]), abs=1e-3)


def test_without_slip_planar_wheels_roll_along_the_chord_of_each_arc() -> None:
    spec, world = burger(), physics(SE2(1.0, 2.0, 0.3), drive=Drive.PLANAR)
    before = world.poses_w()
    world._poses_w[0] = (
        SE2(1.0, 2.0, 0.3) @ SE2(0.5 * math.sin(0.8), 0.5 * (1 - math.cos(0.8)), 0.8)
    ).as_array()
    world._turn_planar_wheels(before)
    chord_m, half_turn_m = math.sin(0.4), 0.5 * spec.wheels.track_m * 0.8
    rolled_m = np.array(world.wheels_rad(0)) * spec.wheels.radius_m
    assert rolled_m == approx([chord_m - half_turn_m, chord_m + half_turn_m])


def test_the_same_commands_give_the_same_bits() -> None:
    first = driven(physics(SE2(1.0, 2.0, 0.5)), (0.15, 0.7), 5.0)
    second = driven(physics(SE2(1.0, 2.0, 0.5)), (0.15, 0.7), 5.0)
    np.testing.assert_array_equal(first, second)


def test_having_only_near_solids_in_the_scene_changes_nothing() -> None:
    """Two robots drive figures among walls, bump into them and into each other."""
    solids = [wall(-1.2, -1.2, 1.2, -1.2), wall(1.2, -1.2, 1.2, 1.2), pole(-0.7, 0.4, 0.05)]
    solids += [pole(5.0 + 0.3 * k, 5.0, 0.05) for k in range(30)]
    starts = (SE2(0.0, 0.0, 0.2), SE2(0.6, 0.5, 3.0))
    lazy = physics(*starts, solids=solids)
    thorough = physics(*starts, solids=solids, all_solids=True)
    bumps = 0
    for k in range(1200):
        twists = [(0.2, 0.9 * math.sin(0.013 * k)), (0.2, 0.9 * math.cos(0.011 * k))]
        lazy.step(twists)
        thorough.step(twists)
        np.testing.assert_allclose(lazy.poses_w(), thorough.poses_w(), atol=1e-9)
        bumps += lazy._data.ncon > 6
    assert lazy._model.ngeom < thorough._model.ngeom - 20
    assert 50 < bumps < 1150


@pytest.mark.parametrize("drive", list(Drive))
def test_each_robot_runs_into_its_own_world_alone(drive: Drive) -> None:
    """Abreast towards three walls: one of the first robot's, one of the second's, one of both."""
    walls = [wall(0.5, -2.0, 0.5, 2.0), wall(1.0, -2.0, 1.0, 2.0), wall(1.5, -2.0, 1.5, 2.0)]
    specs = [burger(), burger()]
    starts = (SE2(0.0, 0.5, 0.0), SE2(0.0, -0.5, 0.0))
    for only_for, stops_m in (
        ((0, 1, None), (0.5, 1.0)),
        ((1, None, 0), (1.0, 0.5)),
        ((1, 1, None), (1.5, 0.5)),
    ):
        world = Physics(
            walls,
            specs,
            starts,
            drive=drive,
            planar_slip=0.0,
            rng=np.random.default_rng(0),
            only_for=only_for,
        )
        reached_m = driven(world, (0.2, 0.0), 9.0)[:, 0]
        front_m = burger().chassis.centre_x_m + burger().chassis.radius_m
        assert reached_m == approx(np.array(stops_m) - 0.01 - front_m, abs=0.02)


def test_robots_of_different_worlds_block_each_other() -> None:
    world = Physics(
        [wall(5.0, 0.0, 6.0, 0.0)],
        [burger(), burger()],
        (SE2(0.0, 0.0, 0.0), SE2(0.5, 0.0, math.pi)),
        drive=Drive.WHEELS,
        planar_slip=0.0,
        rng=np.random.default_rng(0),
        only_for=(0,),
    )
    first, second = driven(world, (0.1, 0.0), 5.0)
    assert second[0] - first[0] > 0.06


def test_no_solid_within_reach_is_left_out() -> None:
    rng = np.random.default_rng(0)
    solids = [wall(*rng.uniform(-3.0, 3.0, 4)) for _ in range(20)] + [
        pole(*rng.uniform(-3.0, 3.0, 2), 0.1) for _ in range(20)
    ]
    nearby = Nearby(solids, reach_m=0.3)
    for point in rng.uniform(-3.0, 3.0, (200, 2)):
        near = nearby.solids_at(point[None])
        assert list(near) == sorted(near)
        assert len(near) <= nearby.most
        for index, solid in enumerate(solids):
            outside_m = abs(solid.T_w_s().inverse() @ point) - [solid.half_x_m, solid.half_y_m]
            distance_m = np.hypot(*np.maximum(outside_m, 0.0))
            assert index in near or distance_m > 0.3
            assert index not in near or distance_m < 0.3 + 2 * math.sqrt(0.5) * 0.25 + 1e-9


def test_physics_that_diverge_are_an_error_and_not_a_fresh_start(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    world = physics(SE2.identity())
    driven(world, (0.2, 0.0), 1.0)
    world._data.qvel[0] = np.nan
    with pytest.raises(FloatingPointError, match=r"diverged at 1\.05 s"):
        world.step([(0.2, 0.0)])
    assert list(tmp_path.iterdir()) == []


def test_the_camera_of_the_scene_is_that_of_the_robot() -> None:
    spec = burger()
    tilted = replace(spec, camera=replace(spec.camera, rpy_rad=(0.0, 0.3, 0.2)))
    model = mujoco.MjModel.from_xml_string(scene_mjcf([], [tilted], [SE2.identity()]))
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    assert model.cam_fovy[0] == approx(2 * math.degrees(math.atan(240 / 616)))
    T_r_c = tilted.camera.T_r_c()
    # MuJoCo's camera has y up and looks along -z.
    np.testing.assert_allclose(
        data.cam_xmat[0].reshape(3, 3) @ np.diag([1, -1, -1]), T_r_c[:3, :3], atol=1e-6
    )
    np.testing.assert_allclose(data.cam_xpos[0], T_r_c[:3, 3], atol=1e-6)


def test_a_robot_turns_no_faster_than_it_can() -> None:
    slow = replace(burger(), max_turn_rate_radps=0.3)
    left, right = slow.wheel_speeds(0.0, 1.5)
    assert slow.wheels.radius_m * (right - left) / slow.wheels.track_m == approx(0.3)


def test_each_reading_has_its_own_jitter() -> None:
    noise = OdometryNoise(scale_sigma=0.0, jitter_rad=0.05, tick_rad=1e-6)
    encoder, drawn = Encoder(noise, rng=np.random.default_rng(7)), np.random.default_rng(7)
    drawn.standard_normal(2)  # the scales
    for wheels_rad in ((1.0, 2.0), (3.0, -4.0)):
        assert encoder.read(wheels_rad) == approx(wheels_rad + 0.05 * drawn.standard_normal(2), abs=2e-6)


def test_planar_wheels_slip_by_a_normal_share_of_each_tick() -> None:
    spec = burger()
    world = physics(SE2.identity(), SE2(3.0, 0.0, 0.0), drive=Drive.PLANAR, planar_slip=0.1)
    drawn, rolled_rad = np.random.default_rng(0), np.zeros((2, 2))
    for _ in range(2):
        before = world.poses_w()
        world._poses_w[:, 0] += (0.01, 0.02)
        world._turn_planar_wheels(before)
        rolled_rad += (
            np.array([[0.01], [0.02]]) / spec.wheels.radius_m * (1 + 0.1 * drawn.standard_normal((2, 2)))
        )
    assert world.wheels_rad(0) == approx(rolled_rad[0])
    assert world.wheels_rad(1) == approx(rolled_rad[1])


def test_a_planar_robot_is_sent_along_the_chord_of_the_next_tick() -> None:
    world = physics(SE2(1.0, 2.0, 0.5), SE2(5.0, 2.0, -1.0), drive=Drive.PLANAR)
    world._poses_w[:, 2] += (0.3, -0.2)
    world.step([(0.1, 1.2), (0.15, 0.0)])
    # Slides lie along the axes of the start; a tick lasts 0.05 s.
    heading = 0.3 + 0.5 * 1.2 * 0.05
    assert world._data.ctrl[:3] == approx([0.1 * math.cos(heading), 0.1 * math.sin(heading), 1.2])
    assert world._data.ctrl[3:] == approx([0.15 * math.cos(-0.2), 0.15 * math.sin(-0.2), 0.0])


def test_a_slot_takes_the_place_shape_and_bounds_of_a_solid() -> None:
    box = replace(wall(1.0, 2.0, 1.0, 3.0), z0_m=0.1, z1_m=0.5, half_y_m=0.2)
    solids = [box, pole(4.0, 5.0, 0.3, z0_m=0.2, z1_m=0.6)]
    model = mujoco.MjModel.from_xml_string(scene_mjcf([], [burger()], [SE2.identity()], slots=3))
    slots = [geom for geom in range(model.ngeom) if model.geom(geom).name.startswith("slot")]
    filled = Slots(model, solids)
    filled.fill((0, 1))
    first, second, third = slots
    assert model.geom_pos[slots].tolist() == [approx([1, 2.5, 0.3]), approx([4, 5, 0.4]), [0, 0, -100]]
    assert model.geom_type[slots[:2]].tolist() == [mujoco.mjtGeom.mjGEOM_BOX, mujoco.mjtGeom.mjGEOM_CYLINDER]
    assert model.geom_size[first] == approx([0.5, 0.2, 0.2])
    assert model.geom_size[second, :2] == approx([0.3, 0.2])
    assert model.geom_quat[first] == approx([math.sqrt(0.5), 0, 0, math.sqrt(0.5)])
    assert model.geom_aabb[first] == approx([0, 0, 0, 0.5, 0.2, 0.2])
    assert model.geom_aabb[second] == approx([0, 0, 0, 0.3, 0.3, 0.2])
    assert model.geom_rbound[slots[:2]] == approx([math.sqrt(0.33), math.hypot(0.3, 0.2)])
    filled.fill((1,))
    assert model.geom_pos[first] == approx([4, 5, 0.4])
    assert model.geom_pos[second, 2] == model.geom_pos[third, 2] == -100


def test_the_burgers_masses_turn_as_cylinders_do() -> None:
    spec = burger()
    model = mujoco.MjModel.from_xml_string(scene_mjcf([], [spec], [SE2.identity()]))
    body, wheel = model.body("r0"), model.body("r0_left")
    mass_kg, wheel_kg = 1.0 - 2 * 0.0285, 0.0285
    across = mass_kg * (3 * 0.069**2 + 0.14**2) / 12
    assert body.inertia == approx([across, across, 0.5 * mass_kg * 0.069**2], rel=1e-4)
    assert body.ipos == approx([0.6 * -0.032, 0.0, 0.45 * 0.15])
    spin = 0.5 * wheel_kg * 0.033**2
    assert sorted(wheel.inertia) == approx(sorted([0.6 * spin, spin, 0.6 * spin]), rel=1e-4)
    assert wheel.pos == approx([0.0, 0.08, 0.033])
    assert model.body("r0_right").pos == approx([0.0, -0.08, 0.033])


def test_fenders_cover_the_upper_half_of_the_wheels() -> None:
    spec = burger()
    model = mujoco.MjModel.from_xml_string(scene_mjcf([], [spec], [SE2.identity()]))
    shell = model.body("r0_shell").id
    geoms = [geom for geom in range(model.ngeom) if model.geom_bodyid[geom] == shell]
    assert model.geom_pos[geoms].tolist() == [
        approx([-0.032, 0, 0.08]), approx([0, 0.08, 0.0495]), approx([0, -0.08, 0.0495])
    ]  # fmt: skip
    assert model.geom_size[geoms[0], :2] == approx([0.069, 0.07])
    assert model.geom_size[geoms[1]] == approx([0.033, 0.009, 0.0165])


def test_a_robot_turns_right_no_faster_than_left() -> None:
    slow = replace(burger(), max_turn_rate_radps=0.3)
    left, right = slow.wheel_speeds(0.0, 1.5)
    assert slow.wheel_speeds(0.0, -1.5) == (right, left)
