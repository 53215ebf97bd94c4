"""Plans that would take minutes are refused at once, whatever their shape."""

from __future__ import annotations

import time

import numpy as np
import pytest

from rendezvous.errors import FloorplanError
from rendezvous.floorplan.houseexpo import parse_floorplan
from rendezvous.floorplan.records import Floorplan
from rendezvous.floorplan.validate import validated
from rendezvous.floorplan.work import (
    MOST_CLOSE_WALLS,
    MOST_CROSSINGS,
    MOST_HOLES,
    MOST_ROOMS,
    MOST_VERTICES,
    check_close_walls,
    check_crossings,
    check_work,
)
from rendezvous.geometry.se2 import Array

MOST_S = 15.0  # for what takes two seconds where nothing else runs
HALL = [(0.0, 0.0), (30.0, 0.0), (30.0, 30.0), (0.0, 30.0)]


def plan(outline_m: object, *holes_m: object) -> Floorplan:
    rings = [np.array(ring, np.float64) for ring in (outline_m, *holes_m)]
    return Floorplan(plan_id="hostile", outline_m=rings[0], holes_m=tuple(rings[1:]))


def random_outline(vertices: int) -> Array:
    return np.random.default_rng(vertices).uniform(0.0, 30.0, (vertices, 2))


def teeth(vertices: int, height_m: float) -> Array:
    """A valid outline with ever thinner teeth."""
    x_m = np.linspace(0.0, 40.0, vertices)
    y_m = np.where(np.arange(vertices) % 2, 5.0, 5.0 + height_m)
    return np.concatenate([np.column_stack([x_m, y_m]), [(40.0, 0.0), (0.0, 0.0)]])


def spokes(vertices: int) -> Array:
    """A star that all but touches itself in the middle."""
    turn_rad = np.linspace(0.0, 2.0 * np.pi, vertices, endpoint=False)
    reach_m = np.where(np.arange(vertices) % 2, 5.0, 20.0)
    return 20.0 + reach_m[:, None] * np.column_stack([np.cos(turn_rad), np.sin(turn_rad)])


def squares(count: int) -> list[Array]:
    side = np.array([(0.0, 0.0), (0.0, 0.1), (0.1, 0.1), (0.1, 0.0)])
    return [side + np.array([0.5 + n % 100 * 0.25, 0.5 + n // 100 * 0.25]) for n in range(count)]


@pytest.mark.parametrize(
    ("hostile", "said"),
    [
        (plan(random_outline(200)), f"crosses itself more than {MOST_CROSSINGS} times"),
        (plan(random_outline(2000)), "crosses itself more than"),
        (plan(random_outline(MOST_VERTICES)), "crosses itself more than"),
        (plan(HALL, random_outline(300)), "crosses itself more than"),
        (plan(random_outline(MOST_VERTICES + 1)), "8,001 vertices; a floor plan has at most 8,000"),
        (plan(HALL, *squares(MOST_HOLES + 1)), "501 holes; a floor plan has at most 500"),
        (plan(teeth(6000, 1.0)), r"pairs of walls within 1\.8 m of each other"),
        (plan(teeth(6000, 30.0)), "pairs of walls within"),
        (plan(spokes(2000)), "pairs of walls within"),
        (plan(teeth(700, 1.0)), r"room\(s\) to start in|reaches"),
        (plan(np.repeat(HALL, 2000, axis=0)), "free space|to start in|crosses itself"),
    ],
)
def test_a_plan_that_would_take_minutes_is_refused_at_once(hostile: Floorplan, said: str):
    began_s = time.process_time()
    with pytest.raises(FloorplanError, match=rf"\Ahostile: .*{said}"):
        validated(hostile, robot_radius_m=0.105)
    assert time.process_time() - began_s < MOST_S


def test_the_bounds_are_exact():
    check_work(plan(np.zeros((MOST_VERTICES, 2))))
    rooms = {"room": [[0, 0, 1, 1]] * MOST_ROOMS}
    raw = {"id": "a", "verts": HALL, "room_category": rooms}
    check_work(parse_floorplan(raw, source="x"))
    rooms["room"].append([0, 0, 1, 1])
    with pytest.raises(FloorplanError, match="2,001 rooms"):
        check_work(parse_floorplan(raw, source="x"))


def test_crossings_are_counted_once_each():
    """A zigzag over a long wall crosses it as often as it has edges."""

    def crossed(times: int) -> Floorplan:
        x_m = np.linspace(0.1, 29.9, times + 1)
        y_m = np.where(np.arange(times + 1) % 2, -1.0, 1.0)
        return plan(
            [(0.0, 0.0), (30.0, 0.0), (31.0, 5.0), *zip(x_m[::-1], y_m[::-1], strict=True), (-1.0, 5.0)]
        )

    check_crossings(crossed(MOST_CROSSINGS - 2))
    with pytest.raises(FloorplanError, match="crosses itself"):
        check_crossings(crossed(MOST_CROSSINGS + 2))


def test_walls_far_apart_are_not_close():
    x_m = np.arange(0.0, 1000.0)
    wide = plan([(0.0, 0.0), *zip(x_m * 10.0 + 5.0, 5.0 + x_m % 2 * 10.0, strict=True), (1e4, 0.0)])
    check_close_walls(wide, 0.9)
    side = int(np.sqrt(2.0 * MOST_CLOSE_WALLS)) + 10
    with pytest.raises(FloorplanError, match="pairs of walls"):
        check_close_walls(plan(np.random.default_rng(0).uniform(0.0, 1.0, (side, 2))), 0.9)
