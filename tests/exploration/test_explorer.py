from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from pytest import approx

from rendezvous.exploration import explorer as explorer_module
from rendezvous.exploration.explorer import Explorer
from rendezvous.exploration.frontier import reach
from rendezvous.exploration.records import ExplorerParameters
from rendezvous.geometry.se2 import Array
from rendezvous.simulation.rays import cast_rays, ray_scene
from rendezvous.simulation.robot import RobotSpec, beam_bearings
from rendezvous.slam.slam import SlamParameters
from tests.simulation.scenes import burger, room_segments


def started(robot: RobotSpec) -> Explorer:
    """An explorer after its first sweep, in the middle of a room of 4 m x 3 m."""
    explorer = Explorer(
        robot, slam=SlamParameters(), parameters=ExplorerParameters(), rng=np.random.default_rng(0)
    )
    for tick in range(5):
        explorer.read_encoders(0.05 * tick, (0.0, 0.0))
    scene = ray_scene(room_segments(4.0, 3.0), np.zeros((0, 3)))
    pose = np.tile([2.0, 1.5, 0.0], (robot.lidar.beams, 1))
    explorer.read_lidar(cast_rays(scene, pose, beam_bearings(robot.lidar), max_range_m=3.5))
    return explorer


@pytest.mark.parametrize("radius_m", [0.105, 0.2])
def test_paths_keep_the_robots_own_radius_and_a_margin(
    monkeypatch: pytest.MonkeyPatch, radius_m: float
) -> None:
    clearances_m = []

    def recorded(*args: object, hard_clearance_m: float, soft_clearance_m: float) -> object:
        clearances_m.append((hard_clearance_m, soft_clearance_m))
        return reach(*args, hard_clearance_m=hard_clearance_m, soft_clearance_m=soft_clearance_m)  # type: ignore[arg-type]

    monkeypatch.setattr(explorer_module, "reach", recorded)
    started(replace(burger(), radius_m=radius_m)).twist()
    assert clearances_m == [approx((radius_m + 0.045, radius_m + 0.195))]


AT = np.array([0.0, 0.0, 0.0])
BURGER_MPS, TURN_RADPS = 0.22, 1.5


def following(path_m: list[tuple[float, float]], *, surfaces_m: Array | None = None) -> Explorer:
    """An explorer on a path, with these surfaces around it, whose plan is not due."""
    explorer = started(burger())
    explorer._path_m = np.array(path_m)
    explorer._plan_until_s = 100.0
    explorer.slam.points_m = np.zeros((0, 2)) if surfaces_m is None else surfaces_m
    return explorer


def test_commands_change_by_no_more_than_the_limits_in_a_tick() -> None:
    explorer = following([(5.0, 0.0)])
    wanted = iter([(0.22, 1.5), (0.22, 1.5), (-0.22, -1.5), (0.0, 0.31)])
    explorer._wanted_twist = lambda pose: next(wanted)  # type: ignore[method-assign]
    # In 0.05 s: 0.05 m/s at 1 m/s^2, and 0.3 rad/s at 6 rad/s^2.
    expected = [(0.05, 0.3), (0.1, 0.6), (0.05, 0.3), (0.0, 0.31)]
    assert [explorer.twist() for _ in expected] == [approx(twist) for twist in expected]


def test_the_pose_is_slams_carried_on_by_odometry() -> None:
    explorer = started(burger())
    explorer.read_encoders(0.25, (0.3, 0.3))
    assert explorer.pose() == approx([0.3 * 0.033, 0.0, 0.0], abs=1e-3)
    explorer.read_encoders(0.30, (0.2, 0.4))
    assert explorer.pose()[2] == approx(0.2 * 0.033 / 0.16, abs=1e-3)


def test_the_robot_slows_down_for_an_error_of_heading_and_turns_first_for_a_large_one() -> None:
    for bearing, expected in (
        (0.0, (BURGER_MPS, 0.0)),
        (0.4, (BURGER_MPS * 0.7, 1.0)),
        (-0.7, (BURGER_MPS * (1 - 0.6 * 0.7 / 0.8), -TURN_RADPS)),
        (0.9, (0.0, TURN_RADPS)),
        (-3.0, (0.0, -TURN_RADPS)),
    ):
        explorer = following([(math.cos(bearing), math.sin(bearing))])
        assert explorer._follow(AT) == approx(expected)


def test_beside_a_surface_the_robot_creeps_and_before_one_it_turns() -> None:
    """At full speed it looks 0.176 m ahead, at two fifths 0.07 m; it keeps 0.125 m from both."""
    for distance_m, expected in ((0.31, (0.22, 0.05)), (0.25, (0.088, 0.05)), (0.18, (0.0, 0.3))):
        explorer = following([(1.0, 0.02)], surfaces_m=np.array([[distance_m, 0.0]]))
        twist = explorer._follow(AT)
        assert twist == approx(expected, rel=0.02)
        # It looks again half a second after it was hindered.
        assert explorer._plan_until_s == approx(100.0 if expected[0] == 0.22 else explorer._time_s + 0.5)


def test_a_plan_is_wanted_without_a_path_when_it_is_due_and_near_its_goal() -> None:
    explorer = following([(0.0, 0.0), (0.31, 0.0)])
    assert not explorer._wants_plan(AT)
    explorer._path_m = np.array([(0.0, 0.0), (0.29, 0.0)])
    assert explorer._wants_plan(AT)
    explorer = following([(2.0, 0.0)])
    explorer._plan_until_s = explorer._time_s
    assert explorer._wants_plan(AT)
    explorer = following([(2.0, 0.0)])
    explorer._path_m = np.zeros((0, 2))
    assert explorer._wants_plan(AT)


def test_wheels_that_turn_in_vain_for_two_sweeps_are_a_bump_ahead() -> None:
    explorer = following([(2.0, 0.0)])
    bumps, still = [], np.zeros(3)
    explorer._goals.bump = lambda place, *, time_s: bumps.append((place, time_s))  # type: ignore[method-assign]
    explorer._twist = (0.2, 0.0)
    for rolled, count in (
        ((0.013, 0.0, 0.0), 1), ((0.011, 0.0, 0.059), 0), ((0.0, 0.0, -0.061), 1), ((0.0, -0.013, 0.0), 2)
    ):  # fmt: skip
        explorer._feel(np.array(rolled), still)
        assert explorer._slipping == count
        if count == 1:  # one sweep may be a mistake
            explorer._twist = (0.2, 0.0)
            explorer._wanted_twist(AT)
            assert bumps == []
    speed, turn = explorer._wanted_twist(np.array([1.0, 2.0, 0.5 * math.pi]))
    ((place, time_s),) = bumps
    assert place == approx([1.0, 2.0 + 1.5 * 0.105, 0.5 * math.pi])
    assert time_s == explorer._time_s
    assert speed == approx(-0.11)
    assert -1.0 <= turn <= 1.0
    assert explorer._slipping == 0
    # Reversing into something is a bump behind, and it drives on forwards.
    explorer._twist, explorer._slipping, explorer._back_off_until_s = (-0.1, 0.0), 2, 0.0
    assert explorer._wanted_twist(AT)[0] == approx(0.11)
    assert bumps[-1][0] == approx([-1.5 * 0.105, 0.0, 0.0])


def test_without_progress_for_five_seconds_the_robot_gives_its_goal_up_and_backs_off() -> None:
    explorer = following([(2.0, 0.5)])
    given_up = []
    explorer._goals.shun = lambda goal, *, time_s: given_up.append((*goal, time_s))  # type: ignore[method-assign]
    for time_s, pose, is_stuck in (
        (4.0, (0.11, 0.0, 0.0), False),  # progress: more than 0.1 m
        (8.9, (0.2, 0.0, 0.5), False),
        (9.1, (0.2, 0.0, 0.5), True),
        (9.2, (0.2, 0.0, -0.61), False),  # progress: more than 0.6 rad
        (14.1, (0.2, 0.05, -0.61), False),
        (14.3, (0.2, 0.05, -0.61), True),
    ):
        explorer._time_s = time_s
        assert explorer._is_stuck(np.array(pose)) == is_stuck
    explorer._back_off(AT)
    assert given_up == [(2.0, 0.5, 14.3)]
    assert len(explorer._path_m) == 0
    turn = explorer._back_off_turn
    for time_s, is_backing in ((15.4, True), (15.6, False)):
        explorer._time_s = time_s
        explorer._path_m, explorer._plan_until_s = np.array([(2.0, 0.0)]), 100.0
        assert (explorer._wanted_twist(AT) == approx((-0.11, turn))) == is_backing
    # Something behind: it turns only.
    explorer._time_s = 15.0
    explorer.slam.points_m = np.array([[-0.14, 0.0]])
    assert explorer._wanted_twist(AT) == approx((0.0, turn))


def test_where_nothing_can_be_reached_the_robot_looks_around() -> None:
    explorer = following([])
    explorer._goals.path_m = lambda *args, **kwargs: np.zeros((0, 2))  # type: ignore[method-assign]
    assert explorer._wanted_twist(AT) == (0.0, 0.5 * TURN_RADPS)
    assert explorer._plan_until_s == explorer._time_s + 4.0


def test_what_lies_behind_on_the_path_is_forgotten() -> None:
    explorer = following([(0.1 * k, 0.0) for k in range(10)])
    explorer._follow(np.array([0.32, 0.01, 0.0]))
    assert explorer._path_m[:, 0] == approx(0.1 * np.arange(3, 10))
