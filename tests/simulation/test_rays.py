import math
from dataclasses import replace

import mujoco
import numpy as np
from pytest import approx

from rendezvous.floorplan.records import Floorplan, Shape
from rendezvous.floorplan.walls import lidar_outline
from rendezvous.geometry.se2 import SE2, Array
from rendezvous.simulation.rays import cast_rays, ray_scene
from rendezvous.simulation.robot import LidarSpec, beam_bearings, noisy_ranges
from rendezvous.simulation.world import scene_mjcf
from tests.simulation.scenes import burger, pole, room_segments, wall

NO_CIRCLES = np.zeros((0, 3))
BEARINGS = beam_bearings(burger().lidar)


def standing(x_m: float, y_m: float, yaw_rad: float, beams: int = 360) -> Array:
    return np.tile([x_m, y_m, yaw_rad], (beams, 1))


def test_ray_stops_at_the_wall() -> None:
    scene = ray_scene(np.array([[2.0, -1.0, 2.0, 1.0]]), NO_CIRCLES)
    pose = standing(0.0, 0.0, 0.0, 3)
    ranges_m = cast_rays(scene, pose, np.array([0.0, 0.3, math.pi]), max_range_m=5.0)
    assert ranges_m[:2] == approx([2.0, 2.0 / math.cos(0.3)], abs=1e-9)
    assert math.isinf(ranges_m[2])


def test_beyond_the_range_there_is_no_hit() -> None:
    scene = ray_scene(np.array([[2.0, -1.0, 2.0, 1.0]]), NO_CIRCLES)
    assert math.isinf(cast_rays(scene, standing(0, 0, 0, 1), np.zeros(1), max_range_m=1.99)[0])


def test_ranges_in_a_room_agree_with_an_exhaustive_search() -> None:
    rng = np.random.default_rng(1)
    starts = rng.uniform(0.0, 9.0, (150, 2))
    clutter = np.hstack([starts, starts + rng.normal(0.0, 0.6, (150, 2))])
    segments = np.concatenate([room_segments(9.0, 9.0), clutter])
    circles = np.hstack([rng.uniform(0.5, 8.5, (20, 2)), rng.uniform(0.01, 0.3, (20, 1))])
    scene = ray_scene(segments, circles)
    for _ in range(50):
        pose = np.array([*rng.uniform(0.1, 8.9, 2), rng.uniform(-4.0, 4.0)])
        ranges_m = cast_rays(scene, standing(*pose), BEARINGS, max_range_m=3.5)
        expected_m = exhaustive(pose, segments, circles)
        np.testing.assert_array_equal(np.isinf(ranges_m), np.isinf(expected_m))
        hit = np.isfinite(ranges_m)
        np.testing.assert_allclose(ranges_m[hit], expected_m[hit], atol=1e-9)


def exhaustive(pose: Array, segments: Array, circles: Array, max_range_m: float = 3.5) -> Array:
    """Every ray against every item, in numpy."""
    d = np.stack([np.cos(pose[2] + BEARINGS), np.sin(pose[2] + BEARINGS)], axis=1)
    best = np.full(len(BEARINGS), np.inf)
    for s in segments:
        e, q = s[2:] - s[:2], s[:2] - pose[:2]
        cross = d[:, 0] * e[1] - d[:, 1] * e[0]
        t, u = (q[0] * e[1] - q[1] * e[0]) / cross, (q[0] * d[:, 1] - q[1] * d[:, 0]) / cross
        best = np.where((t >= 0) & (u >= 0) & (u <= 1), np.minimum(best, t), best)
    for x, y, r in circles:
        q = np.array([x, y]) - pose[:2]
        b = d @ q
        disc = b * b - (q @ q - r * r)
        t = b - np.sqrt(np.maximum(disc, 0.0))
        best = np.where((disc >= 0) & (t >= 0), np.minimum(best, t), best)
    return np.where(best <= max_range_m, best, np.inf)


def test_ranges_agree_with_mujocos_rays_on_the_scene_that_robots_drive_in() -> None:
    plan = Floorplan(plan_id="room", outline_m=np.array([[0.0, 0.0], [5.0, 0.0], [5.0, 4.0], [0.0, 4.0]]))
    walls = [
        wall(0, -0.01, 5, -0.01),
        wall(5.01, 0, 5.01, 4),
        wall(5, 4.01, 0, 4.01),
        wall(-0.01, 4, -0.01, 0),
    ]
    furniture = [pole(1.5, 1.0, 0.1), wall(3.0, 1.0, 4.0, 2.0), pole(3.5, 3.0, 0.3, z0_m=0.5)]
    scene = ray_scene(*lidar_outline(plan, furniture, height_m=0.182))
    spec = burger()
    model = mujoco.MjModel.from_xml_string(scene_mjcf([*walls, *furniture], [spec], [SE2(50.0, 50.0, 0.0)]))
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    ranges_m = cast_rays(scene, standing(2.0, 2.0, 0.3), BEARINGS, max_range_m=10.0)
    for bearing, range_m in zip(BEARINGS, ranges_m, strict=True):
        direction = np.array([math.cos(0.3 + bearing), math.sin(0.3 + bearing), 0.0])
        geom = np.zeros(1, np.int32)
        expected_m = mujoco.mj_ray(model, data, np.array([2.0, 2.0, 0.182]), direction, None, 1, -1, geom)
        assert range_m == approx(expected_m, abs=1e-6)


def test_a_turning_lidar_skews_its_sweep_by_the_turn() -> None:
    spec = burger().lidar
    turn_radps = 2.84
    scene = ray_scene(room_segments(4.0, 4.0), NO_CIRCLES)
    poses = standing(2.0, 2.0, 0.0)
    times_s = np.arange(spec.beams) / (spec.beams * spec.rate_hz)
    poses[:, 2] = turn_radps * times_s
    turning_m = cast_rays(scene, poses, BEARINGS, max_range_m=3.5)
    skew_rad = turn_radps * times_s[-1]
    assert math.degrees(skew_rad) == approx(32.4, abs=0.2)
    still_m = cast_rays(scene, standing(2.0, 2.0, 0.0), BEARINGS + poses[:, 2], max_range_m=3.5)
    np.testing.assert_allclose(turning_m, still_m, atol=1e-12)


def test_the_other_robot_is_a_moving_circle() -> None:
    scene = ray_scene(room_segments(9.0, 9.0), NO_CIRCLES)
    pose = standing(4.5, 4.5, 0.0)
    others_m = np.tile([5.5, 4.5, 0.035], (360, 1))
    ranges_m = cast_rays(scene, pose, BEARINGS, max_range_m=3.5, others_m=others_m)
    assert ranges_m[0] == approx(1.0 - 0.035, abs=1e-12)
    half_angle_deg = math.degrees(math.asin(0.035))
    assert np.flatnonzero(ranges_m < 1.0).size == 2 * math.floor(half_angle_deg) + 1
    others_m[:, 0] += np.linspace(0.0, 0.5, 360)
    moved_m = cast_rays(scene, pose, BEARINGS, max_range_m=3.5, others_m=others_m)
    assert moved_m[0] == ranges_m[0]
    assert moved_m[359] == approx(ranges_m[359] + 0.5, abs=1e-2)


def lidar(**noise: float) -> LidarSpec:
    """The Burger's lidar with other noise."""
    spec = burger().lidar
    return replace(spec, noise=replace(spec.noise, **noise))


def test_noise_has_the_data_sheets_sigma_and_loses_the_stated_share() -> None:
    spec = lidar(dropout=0.05)
    rng = np.random.default_rng(0)
    for range_m in (0.3, 2.0):
        drawn = np.concatenate([noisy_ranges(np.full(360, range_m), spec, rng=rng) for _ in range(100)])
        heard = np.isfinite(drawn)
        assert heard.mean() == approx(0.95, abs=0.01)
        assert drawn[heard].mean() == approx(range_m, abs=5e-4)
        assert drawn[heard].std() == approx(math.hypot(0.01, 0.01 * range_m), rel=0.03)


def test_a_beam_without_echo_stays_without() -> None:
    rng = np.random.default_rng(0)
    drawn = noisy_ranges(np.full(360, np.inf), burger().lidar, rng=rng)
    assert np.isinf(drawn).all()


def test_readings_outside_the_sensors_range_are_not_reported() -> None:
    spec, rng = lidar(dropout=0.0), np.random.default_rng(0)
    drawn = noisy_ranges(np.array([0.05, 0.2, 3.9] * 120), spec, rng=rng)
    assert np.isfinite(drawn.reshape(-1, 3)).all(axis=0).tolist() == [False, True, False]


def test_solids_above_the_scan_plane_are_not_seen() -> None:
    plan = Floorplan(plan_id="room", outline_m=np.array([[0.0, 0.0], [5.0, 0.0], [5.0, 4.0], [0.0, 4.0]]))
    table_top = pole(1.0, 1.0, 0.3, z0_m=0.7, z1_m=0.75)
    assert table_top.shape is Shape.CYLINDER
    _, circles = lidar_outline(plan, [table_top], height_m=0.182)
    assert len(circles) == 0


def test_readings_come_in_the_sensors_steps_up_to_its_last() -> None:
    spec = lidar(sigma_m=0.0, sigma_ratio=0.0, dropout=0.0, step_m=0.05)
    drawn = noisy_ranges(np.array([1.02, 1.03, 0.13, 0.12, 3.5, 3.53]), spec, rng=np.random.default_rng(0))
    assert drawn[:3] == approx([1.0, 1.05, 0.15])
    assert drawn[3:].tolist() == [np.inf, 3.5, np.inf]
    exact = lidar(sigma_m=0.0, sigma_ratio=0.0, dropout=0.0, step_m=0.0)
    bounds_m = np.array([0.12, 3.5, 0.1199, 3.5001])
    assert np.isfinite(noisy_ranges(bounds_m, exact, rng=np.random.default_rng(0))).tolist() == [
        True, True, False, False
    ]  # fmt: skip


def test_a_beams_noise_does_not_depend_on_what_others_hit() -> None:
    spec = lidar(dropout=0.3)
    near = noisy_ranges(np.full(200, 1.0), spec, rng=np.random.default_rng(3))
    mixed_m = np.where(np.arange(200) % 2, 1.0, np.inf)
    mixed = noisy_ranges(mixed_m, spec, rng=np.random.default_rng(3))
    np.testing.assert_array_equal(mixed[1::2], near[1::2])


def test_a_circle_around_the_lidar_is_not_hit() -> None:
    scene = ray_scene(room_segments(9.0, 9.0), np.array([[4.5, 4.5, 0.3]]))
    ranges_m = cast_rays(scene, standing(4.6, 4.5, 0.0, 1), np.zeros(1), max_range_m=9.0)
    assert ranges_m == approx([4.4])
