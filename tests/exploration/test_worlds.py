"""Robots with other lidars, and robots whose worlds differ."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from pytest import approx

from rendezvous.exploration import episode as episode_module
from rendezvous.exploration.episode import Surroundings, furnished, run_episode
from rendezvous.exploration.explorer import Explorer
from rendezvous.exploration.records import EpisodeParameters
from rendezvous.exploration.rendezvous import Sighting
from rendezvous.floorplan.records import Floorplan
from rendezvous.floorplan.walls import wall_boxes
from rendezvous.geometry.occupancy_grid import OccupancyGrid
from rendezvous.geometry.se2 import SE2, Array
from rendezvous.robot_file import LIDARS, load_lidar
from rendezvous.seeds import stream
from rendezvous.simulation.drive import TICK_S
from rendezvous.simulation.rays import cast_rays, ray_scene
from rendezvous.simulation.robot import RobotSpec, beam_bearings, noisy_ranges
from rendezvous.simulation.world import Drive
from tests.simulation.scenes import burger, pole, room_segments

PLANAR = EpisodeParameters(drive=Drive.PLANAR, max_time_s=20.0, first_event_s=(10.0, 20.0), max_events=3)
SIDE_M = 22.0


def standing_map(spec: RobotSpec) -> OccupancyGrid:
    """The map after three sweeps from the middle of a bare hall."""
    explorer = Explorer(spec, slam=PLANAR.slam, parameters=PLANAR.explorer, rng=np.random.default_rng(0))
    lidar, rng = spec.lidar, np.random.default_rng(1)
    T_w_l = np.tile([0.5 * SIDE_M + lidar.x_m, 0.5 * SIDE_M, 0.0], (lidar.beams, 1))
    scene = ray_scene(room_segments(SIDE_M, SIDE_M), np.zeros((0, 3)))
    ranges_m = cast_rays(scene, T_w_l, beam_bearings(lidar), max_range_m=1.2 * lidar.range_max_m)
    explorer.read_encoders(0.0, (0.0, 0.0))
    for k in range(1, 13):
        explorer.read_encoders(k * TICK_S, (0.0, 0.0))
        if k % 4 == 0:
            explorer.read_lidar(noisy_ranges(ranges_m, lidar, rng=rng))
    return explorer.slam.mapper.grid()


def centres_l(grid: OccupancyGrid, chosen: Array, lidar_x_m: float) -> Array:
    """(N, 2) range [m] and bearing [rad] of these cells from the lidar."""
    row, col = np.nonzero(chosen)
    p_m = grid.T_m_g @ (grid.resolution_m * (np.stack([col, row], axis=1) + 0.5)) - [lidar_x_m, 0.0]
    return np.stack([np.hypot(*p_m.T), np.arctan2(p_m[:, 1], p_m[:, 0])], axis=1)


@pytest.mark.parametrize("name", sorted(path.stem for path in LIDARS.glob("*.yaml")))
def test_a_map_holds_what_is_in_the_lidars_field_of_view_and_range(name: str) -> None:
    spec = burger().with_lidar(load_lidar(name))
    lidar = spec.lidar
    grid = standing_map(spec)
    known = centres_l(grid, grid.known(), lidar.x_m)
    afar = known[known[:, 0] > 1.0]
    assert np.abs(afar[:, 1]).max() <= min(0.5 * lidar.field_of_view_rad + 0.05, math.pi)
    # All of it is seen, at a metre or two.
    near = afar[afar[:, 0] < 1.2]
    in_view = np.linspace(-0.5, 0.5, 180)[2:-2] * lidar.field_of_view_rad
    gaps = np.abs(near[:, 1] - in_view[:, None]).min(axis=1)
    assert np.mean(gaps < 0.05) > 0.97
    walls = centres_l(grid, grid.occupied(), lidar.x_m)
    if lidar.range_max_m > 0.5 * SIDE_M:
        assert np.quantile(walls[:, 0], 0.05) == approx(0.5 * SIDE_M, abs=0.3)
    else:
        assert len(walls) == 0
        assert known[:, 0].max() == approx(lidar.clears_m(), abs=0.08)


def test_a_fast_lidar_sweeps_in_a_part_of_the_time_between_two_sweeps(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    swept: list[Array] = []
    spec = burger().with_lidar(load_lidar("hokuyo-ust-20lx"))
    explorer = Explorer(spec, slam=PLANAR.slam, parameters=PLANAR.explorer, rng=np.random.default_rng(0))
    monkeypatch.setattr(explorer.slam, "update", lambda sweep: swept.append(sweep.odometry))
    monkeypatch.setattr(explorer.slam, "has_started", lambda: False)
    for k in range(5):
        explorer.read_encoders(k * TICK_S, (-2.0 * k * TICK_S, 2.0 * k * TICK_S))
    explorer.read_lidar(np.full(spec.lidar.beams, 1.0))
    (odometry,) = swept
    per_s = 2.0 * 2.0 * spec.wheels.radius_m / spec.wheels.track_m
    assert odometry[-1, 2] == approx(per_s * 4 * TICK_S)
    assert odometry[-1, 2] - odometry[0, 2] == approx(per_s * 0.75 / 40.0)


def room_with(*poles: tuple[float, float]) -> Surroundings:
    outline_m = np.array([[0.0, 0.0], [5.0, 0.0], [5.0, 4.0], [0.0, 4.0]])
    plan = Floorplan(plan_id="room", outline_m=outline_m)
    furniture = tuple(pole(x_m, y_m, 0.15) for x_m, y_m in poles)
    return furnished(plan, wall_boxes(plan, height_m=2.5), furniture, burger())


def test_each_robot_maps_its_own_world() -> None:
    here, there = (1.5, 2.8), (3.5, 2.8)
    starts = (SE2(1.0, 1.0, 0.0), SE2(4.0, 1.0, math.pi))
    worlds = (room_with(here), room_with(there))
    robots = (burger().with_lidar(load_lidar("sick-lms")), burger())
    episode = run_episode(worlds, robots, starts, PLANAR, rng=stream(0, "worlds"))
    again = run_episode(worlds, robots, starts, PLANAR, rng=stream(0, "worlds"))
    for i, own_m in enumerate((here, there)):
        grid = episode.last[i].grid
        np.testing.assert_array_equal(grid.cells, again.last[i].grid.cells)
        row, col = np.nonzero(grid.occupied())
        p_m = grid.T_m_g @ (grid.resolution_m * (np.stack([col, row], axis=1) + 0.5))
        p_w = starts[i] @ p_m
        for at_m in (here, there):
            hits = (np.abs(np.hypot(*(p_w - at_m).T) - 0.15) < 0.08).sum()
            assert (hits >= 3) == (at_m == own_m), (i, at_m, hits)


def test_who_stands_in_the_observers_furniture_is_not_seen(monkeypatch: pytest.MonkeyPatch) -> None:
    """The picture of the observer's world would show the one within the other."""
    view = Sighting(range_m=1.0, bearing_rad=0.0, visible_fraction=1.0)
    monkeypatch.setattr(episode_module, "sight", lambda *_, **__: view)
    starts = (SE2(1.0, 1.0, 0.0), SE2(3.0, 1.0, math.pi))
    for y_m, is_seen in ((1.1, False), (1.24, False), (1.4, True)):
        exploration = episode_module._Exploration(
            (room_with((3.0, y_m)), room_with()), (burger(), burger()), starts, PLANAR, stream(0, "seen")
        )
        first, second = exploration._robots
        assert exploration._sight(first, second) == (view if is_seen else None)
        assert exploration._sight(second, first) == view


def test_the_sight_is_that_of_the_observers_world(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[Any] = []
    monkeypatch.setattr(episode_module, "sight", lambda *given, **_: asked.append(given[4]))
    worlds = (room_with((2.0, 2.0)), room_with((2.0, 3.0)))
    starts = (SE2(1.0, 1.0, 0.0), SE2(3.0, 1.0, math.pi))
    exploration = episode_module._Exploration(
        worlds, (burger(), burger()), starts, replace(PLANAR, max_time_s=1.0), stream(0, "seen")
    )
    first, second = exploration._robots
    exploration._sight(first, second)
    exploration._sight(second, first)
    assert [id(obstacles) for obstacles in asked] == [id(world.sight_obstacles) for world in worlds]
