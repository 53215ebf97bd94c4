from __future__ import annotations

import copy
import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from pytest import approx

from rendezvous.exploration import episode as episode_module
from rendezvous.exploration.episode import Surroundings, furnished, run_episode
from rendezvous.exploration.explorer import Explorer
from rendezvous.exploration.records import Episode, EpisodeParameters
from rendezvous.exploration.rendezvous import Sighting
from rendezvous.exploration.starts import draw_starts
from rendezvous.floorplan.furnish import furnish
from rendezvous.floorplan.generate import GeneratorParameters, generate_floorplan
from rendezvous.floorplan.records import Floorplan, Solid
from rendezvous.floorplan.validate import start_regions
from rendezvous.floorplan.walls import wall_boxes
from rendezvous.geometry.se2 import SE2, wrap_angle
from rendezvous.seeds import stream
from rendezvous.simulation.rays import cast_rays
from rendezvous.simulation.robot import RobotSpec, beam_bearings
from rendezvous.simulation.world import Drive
from tests.floorplan.plans import RADIUS_M
from tests.simulation.scenes import burger, pole

SHORT = EpisodeParameters(drive=Drive.WHEELS, max_time_s=150.0, first_event_s=(10.0, 20.0), max_events=3)


@pytest.fixture(scope="module")
def plan() -> Floorplan:
    return generate_floorplan(
        stream(0, "test", 1), plan_id="flat", parameters=GeneratorParameters(), robot_radius_m=RADIUS_M
    )


@pytest.fixture(scope="module")
def furniture(plan: Floorplan) -> tuple[Solid, ...]:
    return furnish(plan, stream(0, "furniture"), density=1.0, robot_radius_m=RADIUS_M)


@pytest.fixture(scope="module")
def surroundings(plan: Floorplan, furniture: tuple[Solid, ...]) -> Surroundings:
    return furnished(plan, wall_boxes(plan, height_m=2.5), furniture, burger())


@pytest.fixture(scope="module")
def starts(plan: Floorplan, furniture: tuple[Solid, ...], surroundings: Surroundings) -> tuple[SE2, SE2]:
    return draw_starts(
        plan,
        start_regions(plan, robot_radius_m=RADIUS_M),
        furniture,
        surroundings.lidar_scene,
        clearance_m=0.22,
        passage_m=0.15,
        least_distance_m=2.0,
        rng=stream(0, "starts"),
    )


@pytest.fixture(scope="module")
def met(surroundings: Surroundings, starts: tuple[SE2, SE2]) -> Episode:
    return run(surroundings, starts, SHORT)


def run(
    surroundings: Surroundings,
    starts: tuple[SE2, SE2],
    parameters: EpisodeParameters,
    robot: RobotSpec | None = None,
) -> Episode:
    robot = robot or burger()
    return run_episode(surroundings, (robot, robot), starts, parameters, rng=stream(0, "episode"))


def test_starts_are_apart_out_of_sight_and_clear_of_everything(
    plan: Floorplan, furniture: tuple[Solid, ...], surroundings: Surroundings
) -> None:
    for k in range(20):
        a, b = draw_starts(
            plan,
            start_regions(plan, robot_radius_m=RADIUS_M),
            furniture,
            surroundings.lidar_scene,
            clearance_m=0.22,
            passage_m=0.15,
            least_distance_m=2.0,
            rng=stream(k, "starts"),
        )
        distance_m = math.dist((a.x_m, a.y_m), (b.x_m, b.y_m))
        assert distance_m >= 2.0
        towards = math.atan2(b.y_m - a.y_m, b.x_m - a.x_m)
        line = cast_rays(
            surroundings.lidar_scene, np.array([[a.x_m, a.y_m, towards]]), np.zeros(1), max_range_m=distance_m
        )
        assert np.isfinite(line[0])
        for start in (a, b):
            around = cast_rays(
                surroundings.lidar_scene,
                np.tile(start.as_array(), (360, 1)),
                np.radians(np.arange(360.0)),
                max_range_m=3.5,
            )
            assert around.min() > 0.18


def test_robots_meet_and_what_is_recorded_fits_together(met: Episode, starts: tuple[SE2, SE2]) -> None:
    assert met.events
    for event in met.events:
        assert any(event.sightings)
        for i, snapshot in enumerate(event.snapshots):
            assert snapshot.trajectory[-1, 0] == snapshot.trajectory_w[-1, 0] == event.t_s
            assert snapshot.trajectory[-1, 1:3] == approx(snapshot.T_m_r.as_array()[:2])
            assert snapshot.trajectory_w[-1, 1:3] == approx(snapshot.T_w_r.as_array()[:2])
            true_m_r = starts[i].inverse() @ snapshot.T_w_r
            assert math.dist(true_m_r.as_array()[:2], snapshot.T_m_r.as_array()[:2]) < 0.1
            assert snapshot.grid.known().sum() * 0.05**2 >= SHORT.least_explored_m2


def test_events_keep_their_distance_in_time_and_travel(met: Episode) -> None:
    assert len(met.events) >= 2
    for before, after in zip(met.events, met.events[1:], strict=False):
        assert after.t_s - before.t_s >= SHORT.event_gap_s - 1e-9
        for i in range(2):
            path = after.snapshots[i].trajectory_w
            since = path[path[:, 0] >= before.t_s - 1e-9]
            # Chords of a path sampled each second are a little shorter than the path.
            assert np.hypot(*np.diff(since[:, 1:3], axis=0).T).sum() > 0.9 * SHORT.event_gap_m


def test_the_same_stream_gives_the_same_bits_whatever_is_recorded_as_truth(
    met: Episode, surroundings: Surroundings, starts: tuple[SE2, SE2], monkeypatch: pytest.MonkeyPatch
) -> None:
    """With every recorded true pose moved by metres, the robots drive and map the same to the bit."""
    honest = episode_module._Robot.snapshot
    lie = SE2(3.0, -2.0, 1.0)

    def lying(robot: Any) -> Any:
        true = honest(robot)
        return replace(true, T_w_r=lie @ true.T_w_r, trajectory_w=true.trajectory_w + 5.0)

    monkeypatch.setattr(episode_module._Robot, "snapshot", lying)
    misled = run(surroundings, starts, SHORT)
    assert misled.simulated_s == met.simulated_s
    assert len(misled.events) == len(met.events)
    for a, b in zip(misled.events, met.events, strict=True):
        for i in range(2):
            assert a.snapshots[i].T_w_r != b.snapshots[i].T_w_r
            np.testing.assert_array_equal(a.snapshots[i].grid.cells, b.snapshots[i].grid.cells)
            np.testing.assert_array_equal(a.snapshots[i].trajectory, b.snapshots[i].trajectory)
            assert a.snapshots[i].T_m_r == b.snapshots[i].T_m_r


class _Recorder:
    """Writes down all that goes into and comes out of the explorers of an episode."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.rngs: list[np.random.Generator] = []
        self.logs: list[list[tuple[str, Any]]] = []
        self.explorers: list[Explorer] = []
        recorder, init, step = self, Explorer.__init__, episode_module.Physics.step

        def make(self: Explorer, *args: Any, rng: np.random.Generator, **kwargs: Any) -> None:
            recorder.rngs.append(copy.deepcopy(rng))
            recorder.logs.append([])
            recorder.explorers.append(self)
            init(self, *args, rng=rng, **kwargs)

        def drive(self: Any, twists: Any) -> None:
            for log, twist in zip(recorder.logs, twists, strict=True):
                log.append(("drive", twist))
            step(self, twists)

        monkeypatch.setattr(Explorer, "__init__", make)
        monkeypatch.setattr(episode_module.Physics, "step", drive)
        for name in ("read_encoders", "read_lidar"):
            monkeypatch.setattr(Explorer, name, self._logged(name, getattr(Explorer, name)))

    def _logged(self, name: str, method: Any) -> Any:
        def logged(explorer: Explorer, *args: Any) -> None:
            self.logs[self.explorers.index(explorer)].append((name, copy.deepcopy(args)))
            method(explorer, *args)

        return logged


def test_measurements_alone_decide_what_a_robot_maps_and_how_it_drives(
    surroundings: Surroundings, starts: tuple[SE2, SE2], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Fed to a robot outside any world, encoders and ranges give the same map and the same commands.

    So neither the truth nor anything of the other robot has another way in.
    """
    with monkeypatch.context() as patch:
        recorder = _Recorder(patch)
        run(surroundings, starts, replace(SHORT, max_time_s=40.0))
    for rng, log, original in zip(recorder.rngs, recorder.logs, recorder.explorers, strict=True):
        alone = Explorer(burger(), slam=SHORT.slam, parameters=SHORT.explorer, rng=rng)
        driven = 0
        for kind, values in log:
            if kind != "drive":
                getattr(alone, kind)(*values)
            elif alone.slam.has_started():
                assert alone.twist() == values
                driven += 1
        assert driven > 200
        np.testing.assert_array_equal(alone.slam.mapper.grid().cells, original.slam.mapper.grid().cells)
        np.testing.assert_array_equal(alone.slam.pose(), original.slam.pose())


def test_a_sweep_sees_the_other_robot_and_has_noise(monkeypatch: pytest.MonkeyPatch) -> None:
    """Two robots a metre apart in a bare room: one beam ends on the other's lidar, all are a little off."""
    outline_m = np.array([[0.0, 0.0], [5.0, 0.0], [5.0, 4.0], [0.0, 4.0]])
    room = Floorplan(plan_id="room", outline_m=outline_m)
    around = furnished(room, wall_boxes(room, height_m=2.5), (), burger())
    with monkeypatch.context() as patch:
        recorder = _Recorder(patch)
        run(around, (SE2(2.0, 2.0, 0.0), SE2(3.0, 2.0, 0.0)), replace(SHORT, max_time_s=1.0))
    (ranges_m,) = next(values for kind, values in recorder.logs[0] if kind == "read_lidar")
    lidar = burger().lidar
    assert ranges_m[0] == approx(1.0 - lidar.cap_radius_m, abs=0.06)
    T_w_l = np.tile([2.0 + lidar.x_m, 2.0, 0.0], (lidar.beams, 1))
    true_m = cast_rays(around.lidar_scene, T_w_l, beam_bearings(lidar), max_range_m=lidar.range_max_m)
    assert true_m[0] > 2.9
    heard = np.isfinite(ranges_m) & np.isfinite(true_m)
    heard[:20] = heard[-20:] = False
    assert 0.012 < (ranges_m[heard] - true_m[heard]).std() < 0.03


def test_planar_drive_meets_and_maps_as_well(surroundings: Surroundings, starts: tuple[SE2, SE2]) -> None:
    planar = run(surroundings, starts, replace(SHORT, drive=Drive.PLANAR))
    assert planar.events
    for i, snapshot in enumerate(planar.last):
        true_m_r = starts[i].inverse() @ snapshot.T_w_r
        assert math.dist(true_m_r.as_array()[:2], snapshot.T_m_r.as_array()[:2]) < 0.1
        assert math.dist(true_m_r.as_array()[:2], snapshot.T_m_r_odometry.as_array()[:2]) > 0.02
        assert np.hypot(*np.diff(snapshot.trajectory_w[:, 1:3], axis=0).T).sum() > 5.0


def test_without_noise_slam_is_good_to_three_centimetres(
    surroundings: Surroundings, starts: tuple[SE2, SE2]
) -> None:
    quiet = replace(
        SHORT,
        max_time_s=60.0,
        odometry_noise=replace(SHORT.odometry_noise, scale_sigma=0.0, jitter_rad=0.0),
    )
    lidar = burger().lidar
    ideal = replace(lidar.noise, sigma_m=0.0, sigma_ratio=0.0, dropout=0.0)
    robot = replace(burger(), lidar=replace(lidar, noise=ideal))
    for i, snapshot in enumerate(run(surroundings, starts, quiet, robot).last):
        true_m_r = starts[i].inverse() @ snapshot.T_w_r
        assert math.dist(true_m_r.as_array()[:2], snapshot.T_m_r.as_array()[:2]) < 0.03
        assert abs(wrap_angle(true_m_r.yaw_rad - snapshot.T_m_r.yaw_rad)) < math.radians(0.3)


def test_the_lidars_poses_run_along_the_knots_and_ahead_of_the_robot() -> None:
    knots = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.4], [1.0, 2.0, 0.8]])
    along = episode_module._poses_along(knots, 4, 0.1)
    robot = np.array([[0.0, 0.0, 0.0], [0.5, 0.0, 0.2], [1.0, 0.0, 0.4], [1.0, 1.0, 0.6]])
    assert along[:, 2] == approx(robot[:, 2])
    assert along[:, 0] == approx(robot[:, 0] + 0.1 * np.cos(robot[:, 2]))
    assert along[:, 1] == approx(robot[:, 1] + 0.1 * np.sin(robot[:, 2]))


def test_what_hangs_higher_than_the_robot_is_not_in_its_way() -> None:
    height_m = burger().size_m[2]
    hanging = [pole(1.0, 1.0, 0.1, z0_m=z0_m) for z0_m in (0.0, height_m - 0.001, height_m)]
    assert episode_module.in_the_way(hanging, burger()) == tuple(hanging[:2])


def test_the_first_event_is_drawn_log_uniformly(surroundings: Surroundings, starts: tuple[SE2, SE2]) -> None:
    parameters = replace(SHORT, first_event_s=(10.0, 1000.0))
    exploration = episode_module._Exploration(
        surroundings, (burger(), burger()), starts, parameters, np.random.default_rng(5)
    )
    schedule = np.random.default_rng(5).spawn(4)[3]
    assert exploration._next_event_s == approx(10.0 ** schedule.uniform(1.0, 3.0))
    # Five sweeps a second, of four ticks each; the path is sampled once a second.
    assert (exploration._ticks_per_sweep, exploration._sweeps_per_step) == (4, 5)


def test_a_rendezvous_takes_time_travel_and_enough_explored(
    surroundings: Surroundings, starts: tuple[SE2, SE2], monkeypatch: pytest.MonkeyPatch
) -> None:
    exploration = episode_module._Exploration(
        surroundings, (burger(), burger()), starts, SHORT, np.random.default_rng(5)
    )
    view = object()
    monkeypatch.setattr(exploration, "_sight", lambda observer, seen: view)
    area_m2, travelled_m, time_s = [4.0, 4.0], [3.0, 3.0], 40.0
    exploration._next_event_s, exploration._next_event_m = 40.0, [3.0, 3.0]

    def views() -> Any:
        exploration._physics._ticks = round(time_s / 0.05)
        for robot, area, travelled in zip(exploration._robots, area_m2, travelled_m, strict=True):
            robot.travelled_m = travelled
            monkeypatch.setattr(robot.explorer.slam.mapper, "known_area_m2", lambda area=area: area)
        return exploration._sightings()

    assert views() == (view, view)
    time_s = 39.95
    assert views() is None
    time_s, travelled_m = 40.0, [3.0, 2.99]
    assert views() is None
    travelled_m, area_m2 = [3.0, 3.0], [4.0, 3.99]
    assert views() is None
    area_m2 = [4.0, 4.0]
    monkeypatch.setattr(exploration, "_sight", lambda observer, seen: None)
    assert views() is None
    # The next one: 10 s and 1 m later.
    monkeypatch.setattr(episode_module._Robot, "snapshot", lambda robot: None)
    exploration._record((None, None))
    assert (exploration._next_event_s, exploration._next_event_m) == (50.0, [4.0, 4.0])


def test_a_sighting_takes_half_of_the_robot_in_view(
    surroundings: Surroundings, starts: tuple[SE2, SE2], monkeypatch: pytest.MonkeyPatch
) -> None:
    exploration = episode_module._Exploration(
        surroundings, (burger(), burger()), starts, SHORT, np.random.default_rng(5)
    )
    asked = []
    for fraction, is_sighting in ((0.49, False), (0.5, True)):
        seen = Sighting(range_m=1.0, bearing_rad=0.0, visible_fraction=fraction)

        def sight(*args: Any, seen: Sighting = seen, **kwargs: Any) -> Sighting:
            asked.append((args, kwargs))
            return seen

        monkeypatch.setattr(episode_module, "sight", sight)
        assert exploration._sight(*exploration._robots) == (seen if is_sighting else None)
    (_, _, T_w_r0, T_w_r1, _), bounds = asked[0]
    assert T_w_r0.as_array() == approx(starts[0].as_array())
    assert T_w_r1.as_array() == approx(starts[1].as_array())
    assert bounds == {"min_range_m": 0.4, "max_range_m": 4.0}
