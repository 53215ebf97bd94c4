from __future__ import annotations

import numpy as np
import pytest

from rendezvous.geometry.se2 import SE2
from rendezvous.pose_estimation.floor_search import floor_poses, same_place
from tests.pose_estimation.observations import (
    Seen,
    burger,
    look_at,
    maps_of,
    observation,
    seen,
    seen_points,
    state,
)


def searched(found: Seen) -> np.ndarray:
    return floor_poses(observation(), found.look, found.belief_9hw, found.peaks)


def test_the_true_pose_is_among_the_first_that_are_tried():
    rng = np.random.default_rng(0)
    for _ in range(20):
        true = state(rng)
        states = searched(seen_points(observation().project(true[None])[0]))
        assert same_place(states[:4], true, 0.1, 0.2).any()


def test_a_robot_that_hangs_in_the_air_is_not_sought_where_it_is():
    # 0.4 m above the floor: as seen by a camera that stands 0.4 m lower.
    true = np.array([1.5, 0.0, 1.0, 0.0, 0.0, 0.0])
    hanging = observation().project(true[None] - [[0.0, 0.0, 0.0, 0.4, 0.0, 0.0]])[0]
    assert not same_place(searched(seen_points(hanging)), true, 0.1, np.pi).any()


def test_poses_that_are_tried_are_apart():
    states = searched(seen_points(observation().project(np.array([[1.5, 0.2, 1.0, 0.0, 0.0, 0.0]]))[0]))
    assert 2 <= len(states) <= 12
    for k, one in enumerate(states):
        assert same_place(states, one, 0.05, 0.1).sum() == 1, k


@pytest.mark.parametrize("x_m", [0.5, 0.8])
def test_a_point_that_is_seen_alone_is_sought_where_its_ray_meets_the_floor(x_m: float):
    true, corner = np.array([x_m, 0.05, 0.7, 0.0, 0.0, 0.0]), 4
    uv_92 = np.full((9, 2), np.nan)
    uv_92[corner] = observation().project(true[None])[0, corner]
    look = look_at(observation().project(true[None])[0])
    best = searched(seen(look, *maps_of(uv_92[None], look)))[0]
    # Headings are all alike then, so it is the corner that is compared.
    places = [(SE2.from_array(one[:3]) @ burger().points_r1()[corner, :2]) for one in (best, true)]
    assert np.hypot(*(places[0] - places[1])) < 0.06 * x_m
