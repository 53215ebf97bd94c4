"""Starts in two rooms with a door between: far enough apart, clear, and connected for the robot."""

from __future__ import annotations

import math

import numpy as np
import pytest
import shapely

from rendezvous.errors import FloorplanError
from rendezvous.exploration.starts import draw_starts
from rendezvous.floorplan.records import Floorplan, Solid
from rendezvous.geometry.se2 import SE2
from rendezvous.simulation.rays import ray_scene
from tests.simulation.scenes import pole, room_segments, wall

ROOMS = (shapely.box(0.0, 0.0, 2.95, 4.0), shapely.box(3.05, 0.0, 6.0, 4.0))
HOUSE = Floorplan(plan_id="house", outline_m=np.array([[0.0, 0.0], [6.0, 0.0], [6.0, 4.0], [0.0, 4.0]]))


def starts(
    *, door_m: float, least_distance_m: float = 1.0, seed: int = 0, more: tuple[Solid, ...] = ()
) -> tuple[SE2, SE2]:
    """Starts on both sides of a wall at x = 3 m whose door begins in the middle of it."""
    walls = (wall(3.0, 0.0, 3.0, 2.0), wall(3.0, 2.0 + door_m, 3.0, 4.0))
    segments_m = [[3.0, 0.0, 3.0, 2.0], [3.0, 2.0 + door_m, 3.0, 4.0]]
    return draw_starts(
        HOUSE,
        ROOMS,
        (*walls, *more),
        ray_scene(np.concatenate([room_segments(6.0, 4.0), segments_m]), np.zeros((0, 3))),
        clearance_m=0.22,
        passage_m=0.15,
        least_distance_m=least_distance_m,
        rng=np.random.default_rng(seed),
    )


def test_starts_are_in_different_rooms_and_head_anywhere() -> None:
    drawn = [starts(door_m=0.8, seed=seed) for seed in range(40)]
    sides = {(a.x_m < 3.0, b.x_m < 3.0) for a, b in drawn}
    assert sides == {(True, False), (False, True)}
    headings = np.array([pose.yaw_rad for pair in drawn for pose in pair])
    assert {int(quarter) for quarter in (headings + math.pi) // (0.5 * math.pi)} == {0, 1, 2, 3}
    places = np.array([(pose.x_m, pose.y_m) for pair in drawn for pose in pair])
    assert (places > 0.2).all()
    assert (places < [5.8, 3.8]).all()
    assert np.ptp(places, axis=0).min() > 3.0


def test_a_door_narrower_than_the_passage_leaves_one_room_to_start_in() -> None:
    starts(door_m=0.5)
    with pytest.raises(FloorplanError, match=r"house: no two starts .* among 1 rooms with space to start in"):
        starts(door_m=0.25)


def test_rooms_too_small_for_the_least_distance_are_told() -> None:
    a, b = starts(door_m=0.8, least_distance_m=5.0)
    assert math.dist((a.x_m, a.y_m), (b.x_m, b.y_m)) >= 5.0
    with pytest.raises(FloorplanError, match=r"no two starts in different rooms, 7\.5 m apart"):
        starts(door_m=0.8, least_distance_m=7.5)


def test_no_start_is_within_the_clearance_of_a_round_or_a_square_solid() -> None:
    more = (pole(1.5, 2.0, 0.6), wall(4.5, 0.5, 4.5, 3.5))
    for seed in range(60):
        for pose in starts(door_m=0.8, seed=seed, more=more):
            assert math.dist((pose.x_m, pose.y_m), (1.5, 2.0)) > 0.6 + 0.18
            assert abs(pose.x_m - 4.5) > 0.18 or not 0.5 <= pose.y_m <= 3.5
