import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from pytest import approx

from rendezvous.errors import ConfigError
from rendezvous.geometry.occupancy_grid import FREE, OCCUPIED, UNKNOWN
from rendezvous.geometry.se2 import Array
from rendezvous.simulation.rays import cast_rays, ray_scene
from rendezvous.simulation.robot import beam_bearings
from rendezvous.slam.mapping import MappingParameters, OccupancyMapper
from rendezvous.slam.scan_match import MatchParameters, _add_point_terms, match_scan, scan_normals
from rendezvous.slam.slam import Slam, SlamParameters, Sweep, compose, deskew, last_part, open_space, relative
from rendezvous.slam.surface_map import SurfaceMap
from tests.simulation.scenes import burger, room_segments

LIDAR = burger().lidar
BEARINGS = beam_bearings(LIDAR)
NO_CIRCLES = np.zeros((0, 3))


def scan(segments: Array, pose: Array, noise_m: float = 0.0, seed: int = 0) -> Array:
    """Ranges of a lidar that stands at a robot pose."""
    at = compose(pose, np.array([LIDAR.x_m, 0.0, 0.0]))
    ranges_m = cast_rays(ray_scene(segments, NO_CIRCLES), np.tile(at, (360, 1)), BEARINGS, max_range_m=3.5)
    return ranges_m + noise_m * np.random.default_rng(seed).standard_normal(360)


def points_of(ranges_m: Array) -> tuple[Array, Array]:
    return deskew(ranges_m, BEARINGS, np.zeros((2, 3)), LIDAR.x_m, 3.0)


def surface_of(segments: Array, pose: Array) -> SurfaceMap:
    p = MatchParameters()
    surface = SurfaceMap(extent_m=20.0, cell_m=p.cell_m, same_side=p.same_side, max_weight=p.max_weight)
    ranges_m = scan(segments, pose)
    points_m, origins_m = points_of(ranges_m)
    normals = scan_normals(points_m, origins_m, np.isfinite(ranges_m), 0.2)
    surface.insert(points_m, normals, np.full(360, 0.01), pose)
    return surface


@pytest.mark.parametrize("offset", [(0.05, -0.03, 0.03), (-0.06, 0.04, -0.05), (0.0, 0.0, 0.08)])
def test_matching_recovers_where_the_scan_was_taken(offset: tuple[float, float, float]) -> None:
    segments = room_segments(4.0, 3.0)
    true_pose = np.array([1.4, 1.3, 0.4])
    surface = surface_of(segments, np.array([1.2, 1.2, 0.2]))
    ranges_m = scan(segments, true_pose)
    points_m, origins_m = points_of(ranges_m)
    normals = scan_normals(points_m, origins_m, np.isfinite(ranges_m), 0.2)
    pose, used = match_scan(
        surface,
        points_m,
        normals,
        np.full(360, 0.01),
        true_pose + offset,
        travelled=np.array([0.3, 0.0, 0.3]),
        parameters=MatchParameters(),
    )
    assert used > 200
    assert pose == approx(true_pose, abs=0.004)


def test_a_scan_of_one_face_of_a_wall_does_not_lock_on_to_the_other() -> None:
    # Seen from below, the face at y = 1.0; from above, the one at y = 1.1.
    below, above = np.array([[3.0, 1.0, -3.0, 1.0]]), np.array([[-3.0, 1.1, 3.0, 1.1]])
    surface = surface_of(below, np.array([0.0, 0.0, 0.0]))
    pose = np.array([0.0, 2.0, 0.0])
    ranges_m = scan(above, pose)
    points_m, origins_m = points_of(ranges_m)
    normals = scan_normals(points_m, origins_m, np.isfinite(ranges_m), 0.2)
    found, used = match_scan(
        surface,
        points_m,
        normals,
        np.full(360, 0.01),
        pose,
        travelled=np.array([1.0, 0.0, 0.0]),
        parameters=MatchParameters(),
    )
    assert used == 0
    assert found == approx(pose)


def test_normals_are_those_of_the_walls_and_point_to_the_sensor() -> None:
    ranges_m = scan(room_segments(4.0, 3.0), np.array([1.0, 1.0, 0.0]))
    points_m, origins_m = points_of(ranges_m)
    normals = scan_normals(points_m, origins_m, np.isfinite(ranges_m), 0.2)
    flat = np.linalg.norm(normals, axis=1) > 0
    assert flat.mean() > 0.9
    # Axis-aligned walls, and each normal turned against its beam.
    away_from_axes = np.minimum(np.abs(normals[flat, 0]), np.abs(normals[flat, 1]))
    assert np.quantile(away_from_axes, 0.9) < 1e-6
    assert ((normals[flat] * (origins_m - points_m)[flat]).sum(axis=1) > 0).all()


def test_deskewing_undoes_a_turn_and_a_drive_within_the_sweep() -> None:
    segments = room_segments(4.0, 3.0)
    begin, twist, knots = np.array([1.5, 1.4, 0.2]), np.array([0.044, 0.0, 0.4]), 5
    odometry = np.array([compose(begin, twist * f) for f in np.linspace(0.0, 1.0, knots)])
    poses = np.array([compose(begin, twist * (i / 360)) for i in range(360)])
    T_w_l = np.array([compose(pose, np.array([LIDAR.x_m, 0.0, 0.0])) for pose in poses])
    ranges_m = cast_rays(ray_scene(segments, NO_CIRCLES), T_w_l, BEARINGS, max_range_m=3.5)
    points_m, _ = deskew(ranges_m, BEARINGS, odometry, LIDAR.x_m, 3.0)
    end = odometry[-1]
    c, s = math.cos(end[2]), math.sin(end[2])
    points_w = points_m @ np.array([[c, s], [-s, c]]) + end[:2]
    off_m = np.min(
        [abs(points_w[:, 0]), abs(points_w[:, 0] - 4.0), abs(points_w[:, 1]), abs(points_w[:, 1] - 3.0)],
        axis=0,
    )
    hit = np.isfinite(ranges_m)
    assert off_m[hit].max() < 1e-3
    skewed_m, _ = deskew(ranges_m, BEARINGS, np.tile(end, (knots, 1)), LIDAR.x_m, 3.0)
    assert np.abs(skewed_m - points_m)[hit].max() > 0.3


def test_open_space_takes_a_run_of_silent_beams_also_across_the_first() -> None:
    ranges_m = np.ones(20)
    ranges_m[[18, 19, 0, 1, 7]] = np.inf
    assert np.flatnonzero(open_space(ranges_m, 4)).tolist() == [0, 1, 18, 19]
    assert not open_space(ranges_m, 5).any()
    assert open_space(np.full(20, np.inf), 5).all()


def test_beams_without_a_measurement_are_no_open_space() -> None:
    ranges_m = np.full(12, np.inf)
    ranges_m[[3, 8]] = np.nan
    assert np.flatnonzero(open_space(ranges_m, 5)).tolist() == [0, 1, 2, 9, 10, 11]
    assert not open_space(np.full(12, np.nan), 5).any()


def test_a_wall_becomes_occupied_the_way_to_it_free_the_rest_stays_unknown() -> None:
    mapper = OccupancyMapper(extent_m=10.0, parameters=MappingParameters())
    point, origin = np.array([[2.0, 0.0]]), np.array([[0.0, 0.0]])
    yes, no = np.ones(1, bool), np.zeros(1, bool)
    for _ in range(3):
        mapper.integrate(point, origin, yes, no, np.array([0.01, 0.01, 0.0]))
    grid = mapper.grid()
    assert grid.sample(np.array([2.02, 0.02])) == OCCUPIED
    assert (grid.sample(np.stack([np.linspace(0.02, 1.97, 30), np.full(30, 0.02)], axis=1)) == FREE).all()
    assert grid.sample(np.array([2.1, 0.02])) == UNKNOWN
    assert grid.occupied().sum() == 1


def test_grazing_beams_of_a_scan_do_not_clear_what_it_hits() -> None:
    mapper = OccupancyMapper(extent_m=10.0, parameters=MappingParameters())
    # Many beams pass through the cell in which the first one ends.
    points = np.array([[1.02, 0.02], *[[2.0, 0.02]] * 9])
    origins = np.full((10, 2), 0.02)
    for _ in range(3):
        mapper.integrate(points, origins, np.ones(10, bool), np.zeros(10, bool), np.zeros(3))
    assert mapper.grid().sample(np.array([1.02, 0.02])) == OCCUPIED


def test_what_moved_away_is_forgotten() -> None:
    mapper = OccupancyMapper(extent_m=10.0, parameters=MappingParameters())
    origin, yes, no = np.full((1, 2), 0.02), np.ones(1, bool), np.zeros(1, bool)
    for _ in range(50):
        mapper.integrate(np.array([[1.02, 0.02]]), origin, yes, no, np.zeros(3))
    for _ in range(20):
        mapper.integrate(np.array([[2.02, 0.02]]), origin, yes, no, np.zeros(3))
    assert mapper.grid().sample(np.array([1.02, 0.02])) == FREE


def test_however_often_it_was_free_a_cell_becomes_occupied_soon() -> None:
    mapper = OccupancyMapper(extent_m=2.0, parameters=MappingParameters())
    origin, yes, no = np.full((1, 2), 0.02), np.ones(1, bool), np.zeros(1, bool)
    for _ in range(1000):
        mapper.integrate(np.array([[0.72, 0.02]]), origin, yes, no, np.zeros(3))
    for _ in range(6):
        assert mapper.grid().sample(np.array([0.52, 0.02])) != OCCUPIED
        mapper.integrate(np.array([[0.52, 0.02]]), origin, yes, no, np.zeros(3))
    assert mapper.grid().sample(np.array([0.52, 0.02])) == OCCUPIED


def test_a_scan_counts_once_in_a_cell_however_many_of_its_beams_end_there() -> None:
    p = MappingParameters()
    mapper = OccupancyMapper(extent_m=2.0, parameters=p)
    points, origins = np.tile([0.52, 0.02], (9, 1)), np.full((9, 2), 0.02)
    mapper.integrate(points, origins, np.ones(9, bool), np.zeros(9, bool), np.zeros(3))
    log_odds, _ = mapper.window()
    assert log_odds.max() == approx(p.hit)
    assert log_odds.min() == approx(p.miss)
    assert mapper.known_area_m2() == approx(p.resolution_m**2)  # one miss does not make a cell free


def test_the_prior_weighs_each_part_of_the_pose_by_its_own_sigma() -> None:
    """One point sees its wall 2 cm too near; y and yaw, a lever of 1 m, share that by their variances."""
    p = MatchParameters()
    wall = SurfaceMap(extent_m=20.0, cell_m=p.cell_m, same_side=p.same_side, max_weight=p.max_weight)
    normal, sigma_m = np.array([[0.0, -1.0]]), np.full(1, 0.01)
    wall.insert(np.array([[1.0, 1.02]]), normal, sigma_m, np.zeros(3))
    for travelled, ratio in (
        ((0.0, 0.0, 0.0), p.prior_xy_m / p.prior_yaw_rad),
        ((0.3, 0.4, 0.0), (p.prior_xy_m + p.prior_xy_per_m * 0.5) / p.prior_yaw_rad),
        ((0.0, 0.0, -0.5), p.prior_xy_m / (p.prior_yaw_rad + p.prior_yaw_per_rad * 0.5)),
    ):
        pose, used = match_scan(
            wall, np.array([[1.0, 1.0]]), normal, sigma_m, np.zeros(3),
            travelled=np.array(travelled), parameters=replace(p, iterations=20),
        )  # fmt: skip
        assert used == 1
        assert pose[0] == approx(0.0, abs=1e-4)
        assert pose[1] > 0.0
        assert pose[1] / pose[2] == approx(ratio**2, rel=0.1)


def test_a_map_smaller_than_the_world_keeps_what_it_can() -> None:
    mapper = OccupancyMapper(extent_m=2.0, parameters=MappingParameters())
    for _ in range(3):
        mapper.integrate(
            np.array([[5.0, 0.02]]), np.full((1, 2), 0.02), np.ones(1, bool), np.zeros(1, bool), np.zeros(3)
        )
    grid = mapper.grid()
    assert grid.sample(np.array([0.9, 0.02])) == FREE
    assert not grid.occupied().any()


def slam_with(*, no_echo_m: float) -> Slam:
    """SLAM with the Burger's lidar."""
    return Slam(
        bearings_rad=BEARINGS,
        lidar_x_m=LIDAR.x_m,
        lidar_sigma=(LIDAR.noise.sigma_m, LIDAR.noise.sigma_ratio),
        no_echo_m=no_echo_m,
        parameters=SlamParameters(),
    )


def test_slam_walks_a_room_with_wheels_that_spin() -> None:
    """A circle through a room with 2 cm of range noise; for two sweeps the wheels turn in vain."""
    segments = np.concatenate([room_segments(4.0, 3.0), [[1.0, 0.0, 1.0, 0.8], [3.0, 3.0, 3.0, 2.1]]])
    slam = slam_with(no_echo_m=LIDAR.clears_m())
    start = np.array([2.0, 0.8, 0.0])
    odometry = np.zeros(3)
    for k in range(100):
        true_pose = np.array([2.0 + 0.7 * math.sin(0.06 * k), 1.5 - 0.7 * math.cos(0.06 * k), 0.06 * k])
        if k:
            odometry = compose(odometry, relative(before, true_pose) * [1.01, 1.0, 1.02])  # noqa: F821
        if k in (40, 41):
            odometry = compose(odometry, np.array([0.04, 0.0, 0.1]))
        ranges_m = scan(segments, true_pose, noise_m=0.02, seed=k)
        slam.update(Sweep(ranges_m=ranges_m, odometry=np.tile(odometry, (5, 1))))
        before = true_pose  # noqa: F841
    error = relative(relative(start, true_pose), slam.pose())
    off_by = relative(relative(start, true_pose), odometry)
    assert math.hypot(error[0], error[1]) < 0.03
    assert abs(error[2]) < math.radians(1.0)
    assert math.hypot(off_by[0], off_by[1]) > 0.1


def test_a_short_sighted_lidar_clears_no_farther_than_it_sees() -> None:
    """Nothing within 1.5 m: the map is free up to there, and beyond it unknown."""
    slam = slam_with(no_echo_m=replace(LIDAR, range_max_m=1.5).clears_m())
    for _ in range(4):
        slam.update(Sweep(ranges_m=np.full(360, np.inf), odometry=np.zeros((5, 3))))
    known = slam.mapper.grid().cell_centres(slam.mapper.grid().known())
    assert 1.2 < np.hypot(known[:, 0] - LIDAR.x_m, known[:, 1]).max() < 1.5


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: MatchParameters(cell_m=0.0), "MatchParameters: cell_m is 0.0; must be from 0.02 to 1"),
        (lambda: MatchParameters(iterations=0), "iterations is 0"),
        (lambda: MappingParameters(resolution_m=1e-9), "resolution_m is 1e-09"),
        (lambda: MappingParameters(free=0.01), "free is 0.01; must be from -4 to 0"),
        (lambda: MappingParameters(occupied=-0.01), "occupied is -0.01; must be from 0 to 4"),
        (lambda: SlamParameters(extent_m=-5.0), "extent_m is -5.0"),
        (
            lambda: SlamParameters(extent_m=400.0, mapping=MappingParameters(resolution_m=0.01)),
            "at most 8000",
        ),
    ],
)
def test_settings_that_cannot_work_are_refused(make: Callable[[], Any], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        make()


def test_composition_and_its_inverse() -> None:
    a, b = np.array([1.0, -2.0, 4.0]), np.array([0.3, 0.7, -9.0])
    assert relative(a, compose(a, b)) == approx(b)


def normals_of(points: Array, valid: NDArray[np.bool_]) -> Array:
    return scan_normals(points, np.zeros_like(points), valid, 0.2)


def test_a_normal_takes_four_points() -> None:
    points = np.stack([np.full(40, 1.0), 0.01 * np.arange(40)], axis=1)
    for seen in (3, 4):
        valid = np.zeros(40, bool)
        valid[10 : 10 + seen] = True
        normals = normals_of(points, valid)
        assert normals[11] == approx([-1.0, 0.0] if seen == 4 else [0.0, 0.0], abs=1e-6)
        assert not normals[~valid].any()


def test_points_that_scatter_by_half_of_their_length_are_no_line() -> None:
    # Variances across and along a zigzag of n points: a^2 and (n^2 - 1) / 12 steps^2.
    along = 0.01 * np.arange(13)
    for share, is_line in ((0.15, True), (0.3, False)):
        across = math.sqrt(share * 14.0) * 0.01 * np.where(np.arange(13) % 2, 1.0, -1.0)
        points = np.full((60, 2), 5.0)
        points[10:23] = np.stack([1.0 + across, along], axis=1)
        valid = np.zeros(60, bool)
        valid[10:23] = True
        assert normals_of(points, valid)[16].any() == is_line


def silent_sweep(begin: Array, end: Array, *, no_echo: slice = slice(0)) -> Sweep:
    """A sweep of a room while odometry goes from one pose to the other; only odometry moves."""
    ranges_m = scan(room_segments(4.0, 3.0), np.array([2.0, 1.5, 0.0]))
    ranges_m[no_echo] = np.inf
    return Sweep(ranges_m=ranges_m, odometry=np.array([begin, end]))


def test_the_maps_origin_is_where_the_first_sweep_began() -> None:
    slam = slam_with(no_echo_m=3.0)
    begin = np.array([1.0, 2.0, 0.3])
    slam.update(silent_sweep(begin, compose(begin, np.array([0.04, 0.01, 0.1]))))
    assert slam.pose() == approx([0.04, 0.01, 0.1])


def test_the_surface_takes_a_scan_at_each_keyframe_and_no_other(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each point with its range's own sigma."""
    slam, inserted, at = slam_with(no_echo_m=3.0), [], np.zeros(3)

    def moved_to(*args: object, **kwargs: object) -> tuple[Array, int]:
        return at, 360

    monkeypatch.setattr("rendezvous.slam.slam.match_scan", moved_to)
    monkeypatch.setattr(slam._surface, "insert", lambda *args: inserted.append(args))
    taken = []
    for pose in (
        (0, 0, 0),
        (0.1, 0.1, 0),
        (0.11, 0.11, 0),
        (0.2, 0.2, 0),
        (0.2, 0.2, 0.14),
        (0.2, 0.2, -0.16),
    ):
        at = np.array(pose, float)
        before = len(inserted)
        slam.update(silent_sweep(np.zeros(3), np.zeros(3), no_echo=slice(0, 3)))
        taken.append(len(inserted) > before)
    assert taken == [True, False, True, False, False, True]
    _, _, sigma_m, pose_m = inserted[-1]
    assert pose_m == approx(at)
    ranges_m = scan(room_segments(4.0, 3.0), np.array([2.0, 1.5, 0.0]))
    noise = LIDAR.noise
    assert sigma_m[3:] == approx(np.sqrt(noise.sigma_m**2 + (noise.sigma_ratio * ranges_m[3:]) ** 2))


def test_the_known_area_is_that_of_free_and_occupied_cells() -> None:
    mapper = OccupancyMapper(extent_m=2.0, parameters=MappingParameters())
    for _ in range(2):
        mapper.integrate(
            np.array([[0.52, 0.02]]), np.full((1, 2), 0.02), np.ones(1, bool), np.zeros(1, bool), np.zeros(3)
        )
    assert mapper.known_area_m2() == approx(11 * 0.05**2)  # ten cells on the way and the one that was hit


def test_a_lone_point_and_the_prior_meet_where_their_weights_balance() -> None:
    """The wall's variance: the point's, 1 cm over its root weight, and 5 mm; both are Cauchy-weighted."""
    p = replace(MatchParameters(), iterations=50)
    wall = SurfaceMap(extent_m=20.0, cell_m=p.cell_m, same_side=p.same_side, max_weight=p.max_weight)
    normal = np.array([[0.0, -1.0]])
    wall.insert(np.array([[0.0, 1.05]]), normal, np.full(1, 0.01), np.zeros(3))
    pose, _ = match_scan(
        wall, np.array([[0.0, 1.02]]), normal, np.full(1, 0.02), np.zeros(3),
        travelled=np.array([0.1, 0.0, 0.0]), parameters=p,
    )  # fmt: skip
    # Straight ahead a heading does not matter: y alone moves, from 0 towards 0.03.
    sigma_m = p.prior_xy_m + 0.1 * p.prior_xy_per_m
    variance = 0.02**2 + 1e-4 + 2.5e-5

    def pull(y_m: float) -> float:
        off, left_m = y_m / sigma_m, 0.03 - y_m
        return left_m / (variance + left_m**2 / 4.0) - y_m / sigma_m**2 / (1.0 + off**2 / 9.0)

    low, high = 0.0, 0.03
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if pull(middle) > 0.0 else (low, middle)
    assert pose == approx([0.0, low, 0.0], abs=2e-5)


def test_points_add_the_normal_equations_of_their_distances_from_lines() -> None:
    pose, points = np.array([0.3, -0.2, 0.7]), np.array([[1.0, 0.2], [0.4, -1.1], [2.0, 2.0]])
    sigma_m, matched = np.array([0.01, 0.03, 0.02]), np.array([1, 0, -1], np.int32)
    elements = np.array([[1.2, -0.9, 0.6, 0.8, 2.0, 1.0], [1.0, 0.6, -0.8, 0.6, 5.0, 1.0]])

    def residuals(at: Array) -> Array:
        c, s = math.cos(at[2]), math.sin(at[2])
        moved = at[:2] + points[:2] @ np.array([[c, s], [-s, c]])
        lines = elements[matched[:2]]
        return (lines[:, 2:4] * (moved - lines[:, :2])).sum(axis=1)

    r, step = residuals(pose), 1e-6
    J = np.stack([(residuals(pose + d) - residuals(pose - d)) / (2 * step) for d in step * np.eye(3)], axis=1)
    w = 1.0 / (sigma_m[:2] ** 2 + 1e-4 / elements[matched[:2], 4] + 2.5e-5 + r**2 / 4.0)
    H, g = np.eye(3), np.ones(3)
    _add_point_terms(points, sigma_m, matched, elements, pose, H, g)
    np.testing.assert_allclose(H, np.eye(3) + J.T @ (w[:, None] * J), rtol=1e-6)
    np.testing.assert_allclose(g, 1.0 + J.T @ (w * r), rtol=1e-6)


def test_the_last_part_of_a_path_is_evenly_spaced_up_to_its_end() -> None:
    knots = np.array([[0.0, 0.0, 0.0], [1.0, 2.0, 0.5], [2.0, 4.0, 1.0], [4.0, 4.0, 1.0]])
    np.testing.assert_array_equal(last_part(knots, 3.0), knots)
    np.testing.assert_array_equal(last_part(knots, 7.0), knots)
    np.testing.assert_allclose(last_part(knots, 2.0), knots[1:])
    np.testing.assert_allclose(last_part(knots, 0.25), [[3.5, 4.0, 1.0], [4.0, 4.0, 1.0]])
    np.testing.assert_allclose(last_part(knots, 1.5), [[1.5, 3.0, 0.75], [2.5, 4.0, 1.0], [4.0, 4.0, 1.0]])


def test_normals_reach_as_far_as_is_asked_and_no_less_than_before() -> None:
    parameters = SlamParameters()
    step_rad = math.radians(1.0)
    assert parameters.with_normals(step_rad, to_m=0.0) == parameters
    assert parameters.with_normals(step_rad, to_m=20.0).match.normal_radius_m == approx(
        1.75 * step_rad * 20.0
    )
    assert parameters.with_normals(step_rad, to_m=100.0).match.normal_radius_m == 0.8
