from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
from pytest import approx

from rendezvous.exploration.explorer import Goals, _keeps_clear, _pursued
from rendezvous.exploration.records import ExplorerParameters
from rendezvous.geometry.se2 import SE2, Array
from rendezvous.slam.mapping import MappingParameters

NO_PATH = np.zeros((0, 2))
POSE = np.array([2.0, 2.0, 0.0])


def room(*gaps: tuple[slice, slice]) -> Any:
    """A map of 6 m x 4 m in cells of 0.05 m, all free, with walls but for the gaps, unknown beyond."""
    log_odds = np.full((80, 120), -2.0, np.float32)
    log_odds[[0, 1, -2, -1]] = 2.0
    log_odds[:, [0, 1, -2, -1]] = 2.0
    for gap in gaps:
        log_odds[gap] = -2.0
    return SimpleNamespace(parameters=MappingParameters(), window=lambda: (log_odds, SE2.identity()))


LEFT, RIGHT = (slice(30, 50), slice(0, 2)), (slice(30, 50), slice(-2, None))
WIDE_RIGHT = (slice(10, 70), slice(-2, None))


def goals(seed: int = 0) -> Goals:
    return Goals(ExplorerParameters(), robot_radius_m=0.105, rng=np.random.default_rng(seed))


def led_to(
    chosen: Goals, mapper: Any, last: Array = NO_PATH, *, time_s: float = 0.0, keep: bool = False
) -> Array:
    path_m = chosen.path_m(mapper, POSE, last, time_s=time_s, keep_patrol=keep)
    return path_m[-1]


def test_the_nearer_of_two_equal_frontiers_is_the_goal() -> None:
    assert led_to(goals(), room(LEFT, RIGHT)) == approx([0.05, 2.0], abs=0.1)
    assert led_to(goals(), room(RIGHT)) == approx([5.95, 2.0], abs=0.1)


def test_a_much_longer_frontier_is_worth_some_metres() -> None:
    # 2 m farther, 2 m longer: not at 0.6 m a metre of frontier, but at 1.5 m.
    assert led_to(goals(), room(LEFT, WIDE_RIGHT))[0] < 1.0
    eager = Goals(ExplorerParameters(gain=1.5), robot_radius_m=0.105, rng=np.random.default_rng(0))
    assert led_to(eager, room(LEFT, WIDE_RIGHT))[0] > 5.0


def test_a_frontier_nearer_than_the_lookahead_is_no_goal() -> None:
    beside_left = np.array([0.25, 2.0, 0.0])
    path_m = goals().path_m(room(LEFT, RIGHT), beside_left, NO_PATH, time_s=0.0, keep_patrol=False)
    assert path_m[-1] == approx([5.95, 2.0], abs=0.1)


def test_a_goal_given_up_is_avoided_for_half_a_minute() -> None:
    chosen, mapper = goals(), room(LEFT, RIGHT)
    chosen.shun(led_to(chosen, mapper) + np.array([0.0, 0.45]), time_s=0.0)
    assert led_to(chosen, mapper, time_s=29.0)[0] > 5.0
    assert led_to(chosen, mapper, time_s=31.0)[0] < 1.0
    chosen.shun(led_to(chosen, mapper, time_s=31.0) + np.array([0.0, 0.6]), time_s=31.0)
    assert led_to(chosen, mapper, time_s=32.0)[0] < 1.0


def test_paths_lead_around_a_place_where_the_robot_bumped() -> None:
    chosen, mapper = goals(), room(LEFT)
    straight = chosen.path_m(mapper, POSE, NO_PATH, time_s=0.0, keep_patrol=False)
    chosen.bump(np.array([1.0, 2.0, 0.0]), time_s=0.0)
    around = chosen.path_m(mapper, POSE, NO_PATH, time_s=1.0, keep_patrol=False)
    assert np.hypot(*(straight - [1.0, 2.0]).T).min() < 0.1
    assert np.hypot(*(around - [1.0, 2.0]).T).min() > 0.1
    later = chosen.path_m(mapper, POSE, NO_PATH, time_s=31.0, keep_patrol=False)
    np.testing.assert_array_equal(later, straight)


def test_without_frontiers_it_patrols_and_can_keep_its_goal() -> None:
    chosen, mapper = goals(), room()
    drawn = np.array([led_to(chosen, mapper) for _ in range(20)])
    assert np.ptp(drawn, axis=0).min() > 1.5
    # Room to turn: the radius and the soft margin from every wall.
    assert drawn.min() > 0.1 + 0.25
    assert (drawn < [5.9 - 0.25, 3.9 - 0.25]).all()
    last = np.array([[2.0, 2.0], [4.02, 1.03]])
    assert led_to(chosen, mapper, last, keep=True) == approx([4.05, 1.05], abs=0.06)
    walled_in = np.array([[2.0, 2.0], [0.0, 0.0]])
    assert led_to(chosen, mapper, walled_in, keep=True).min() > 0.3


def test_where_nothing_can_be_reached_there_is_no_path() -> None:
    log_odds = np.full((40, 40), 2.0, np.float32)
    mapper: Any = SimpleNamespace(parameters=MappingParameters(), window=lambda: (log_odds, SE2.identity()))
    pose = np.array([1.0, 1.0, 0.0])
    assert goals().path_m(mapper, pose, NO_PATH, time_s=0.0, keep_patrol=False).shape == (0, 2)


def clear(point_m: tuple[float, float], speed: float, turn: float = 0.0) -> bool:
    return bool(_keeps_clear(np.array([point_m]), np.zeros(3), speed, turn, 0.125))


def test_a_surface_ahead_stops_the_robot_within_its_foresight() -> None:
    # In 0.8 s at 0.2 m/s it drives 0.16 m.
    assert not clear((0.28, 0.0), 0.2)
    assert clear((0.29, 0.0), 0.2)
    assert not clear((0.16, 0.12), 0.2)
    assert clear((0.16, 0.13), 0.2)
    assert not clear((-0.28, 0.0), -0.2)


def test_a_surface_that_the_robot_leaves_does_not_stop_it() -> None:
    assert clear((-0.1, 0.0), 0.2)
    assert clear((0.1, 0.0), -0.2)
    assert clear((0.1, 0.0), 0.0, 1.5)


def test_a_turn_to_the_left_meets_what_stands_to_the_left() -> None:
    # After 0.8 s at 0.2 m/s and 1.5 rad/s it is at (0.13, 0.09).
    assert not clear((0.2, 0.18), 0.2, 1.5)
    assert clear((0.2, 0.18), 0.2, -1.5)
    assert not clear((0.2, -0.18), 0.2, -1.5)


def test_surfaces_are_carried_from_the_scan_to_the_robot() -> None:
    # The scan was taken 1 m behind the robot, turned by a quarter to its left.
    scan_r = np.array([-1.0, 0.0, 0.5 * np.pi])
    assert not _keeps_clear(np.array([[0.0, -1.2]]), scan_r, 0.2, 0.0, 0.125)
    assert _keeps_clear(np.array([[0.0, 1.2]]), scan_r, 0.2, 0.0, 0.125)


def test_the_path_is_pursued_from_its_nearest_point_on() -> None:
    path_m = np.stack([np.arange(10) * 0.1, np.zeros(10)], axis=1)
    assert _pursued(path_m, np.array([0.31, 0.05, 0.0]), 0.25) == (3, 6)
    assert _pursued(path_m, np.array([0.85, 0.0, 0.0]), 0.25)[1] == 9
