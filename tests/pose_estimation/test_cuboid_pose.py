from __future__ import annotations

import numpy as np
import pytest

from rendezvous.geometry.se2 import SE2, Array
from rendezvous.pose_estimation.cuboid_pose import Reading, readings_in_space, readings_on_floor
from rendezvous.pose_estimation.keypoint_evidence import KeypointNoise, evidence_of
from rendezvous.pose_estimation.observation_model import ObservationModel
from tests.pose_estimation.observations import (
    EXACT,
    Seen,
    error,
    look_at,
    maps_of,
    observation,
    seen,
    seen_points,
    shaken,
    state,
)

TURNED = [2, 3, 0, 1, 6, 7, 4, 5, 8]
"""The corners as they would be named if the robot's front were its back."""
AHEAD = np.array([1.2, -0.1, 0.4, 0.0, 0.0, 0.0])


def read(model: ObservationModel, found: Seen, *, floor: bool, noise: KeypointNoise = EXACT) -> list[Reading]:
    if floor:
        return readings_on_floor(model, found.evidence(noise), found.look, found.belief_9hw, found.peaks)
    return readings_in_space(model, found.evidence(noise), found.look, found.cuboids)


def points(true: Array) -> Array:
    """(9, 2) [px] of the cuboid in this state."""
    return observation().project(true[None])[0]


@pytest.mark.parametrize("floor", [True, False])
@pytest.mark.parametrize("pitch_rad", [0.0, 0.15])
def test_exact_maps_give_the_pose_back(floor: bool, pitch_rad: float):
    rng, model = np.random.default_rng(0), observation(pitch_rad=pitch_rad)
    for _ in range(5):
        true = state(rng)
        true[1] *= 0.5
        best = read(model, seen_points(model.project(true[None])[0]), floor=floor)[0]
        found = error(best.T_r0_r1, true)
        assert np.abs(found[:2]).max() < 0.004 * true[0]
        assert abs(found[2]) < np.radians(0.5)
        assert best.T_c_o == pytest.approx(model.T_c_o(true), abs=0.015)
        assert best.explained > 0.95


@pytest.mark.parametrize("floor", [True, False])
def test_covariances_predict_the_errors(floor: bool):
    rng, model = np.random.default_rng(1), observation()
    noise = KeypointNoise(floor_cells=0.15, scale=0.0)
    distances = []
    for _ in range(60):
        true = state(rng)
        best = read(model, seen_points(shaken(rng, points(true), cells=0.15)), floor=floor, noise=noise)[0]
        found = error(best.T_r0_r1, true)
        distances.append(found @ np.linalg.solve(best.covariance, found))
    # Chi-squared with 3 degrees of freedom: the mean of 60 has a standard deviation of 0.32.
    assert np.mean(distances) == pytest.approx(3.0, abs=0.9)


@pytest.mark.parametrize("yaw_rad", [0.7, -2.0])
def test_the_distance_is_the_least_certain_in_the_axes_of_the_robot_seen(yaw_rad: float):
    noise = KeypointNoise(floor_cells=0.2, scale=0.0)
    true = np.array([2.5, 0.0, yaw_rad, 0.0, 0.0, 0.0])
    covariance = read(observation(), seen_points(points(true)), floor=True, noise=noise)[0].covariance
    along = SE2(0.0, 0.0, -yaw_rad) @ np.array([1.0, 0.0])
    across = np.array([-along[1], along[0]])
    assert along @ covariance[:2, :2] @ along > 4.0 * (across @ covariance[:2, :2] @ across)


def test_missing_points_cost_little_and_widen_the_covariance():
    rng, model = np.random.default_rng(2), observation()
    for _ in range(6):
        true = state(rng)
        uv = points(true)
        whole = read(model, seen_points(uv), floor=True)[0]
        uv[rng.choice(8, 3, replace=False)] = np.nan
        part = read(model, seen_points(uv), floor=True)[0]
        assert np.abs(error(part.T_r0_r1, true)[:2]).max() < 0.01 * true[0]
        assert np.linalg.det(part.covariance) > np.linalg.det(whole.covariance)


@pytest.mark.parametrize("floor", [True, False])
def test_a_stray_peak_is_not_followed(floor: bool):
    true = np.array([1.5, 0.1, 0.7, 0.0, 0.0, 0.0])
    uv = points(true)
    stray = uv.copy()
    stray[3] += [40.0, -30.0]
    best = read(observation(), seen(look_at(uv), *maps_of(stray[None], look_at(uv))), floor=floor)[0]
    assert np.abs(error(best.T_r0_r1, true)) == pytest.approx(0.0, abs=0.03)
    assert best.explained < 0.95


def test_front_and_back_stay_open_where_the_maps_leave_them_open():
    uv = points(AHEAD)
    look = look_at(uv)
    front, fields = maps_of(uv[None], look)
    back, _ = maps_of(uv[None, TURNED], look)
    both = seen(look, np.maximum(0.6 * front, 0.4 * back), fields)
    noise = KeypointNoise(floor_cells=0.2, scale=0.3)
    first, second = read(observation(), both, floor=True, noise=noise)[:2]
    assert abs(error(first.T_r0_r1, AHEAD)[2]) < 0.1
    assert abs(error(second.T_r0_r1, AHEAD)[2]) > 2.5
    assert first.log_evidence > second.log_evidence
    assert np.hypot(*error(second.T_r0_r1, AHEAD)[:2]) < 0.2


@pytest.mark.parametrize("floor", [True, False])
def test_a_turned_robot_is_read_as_turned(floor: bool):
    yaw = read(observation(), seen_points(points(AHEAD)[TURNED]), floor=floor)[0].T_r0_r1.yaw_rad
    assert np.cos(yaw - 0.4) < -0.99


def test_on_the_floor_three_points_are_enough():
    rng, model = np.random.default_rng(3), observation()
    for _ in range(6):
        true = state(rng, lean=0.0)
        uv = points(true)
        uv[[1, 2, 4, 5, 6, 7]] = np.nan
        found = seen_points(uv)
        readings = read(model, found, floor=True)
        assert len(readings) <= 4
        errors = np.abs([error(one.T_r0_r1, true) for one in readings])
        assert (errors < [0.1 * true[0], 0.1 * true[0], 0.1]).all(axis=1).any()
        assert read(model, found, floor=False) == []


@pytest.mark.parametrize("floor", [True, False])
def test_the_robot_in_the_middle_is_read_though_another_is_beside_it(floor: bool):
    both = np.stack([AHEAD, AHEAD + np.array([0.1, 0.26, 1.0, 0.0, 0.0, 0.0])])
    uv = observation().project(both)
    look = look_at(uv[0])
    readings = read(observation(), seen(look, *maps_of(uv, look)), floor=floor)
    assert min(np.abs(error(one.T_r0_r1, AHEAD)).max() for one in readings) < 0.02


def test_two_looks_at_one_robot_say_no_more_than_one():
    found = seen_points(points(AHEAD))
    once, twice = (
        readings_on_floor(
            observation(),
            evidence_of([(found.look, found.peaks)] * count, sigma_cells=1.0, noise=EXACT),
            found.look,
            found.belief_9hw,
            found.peaks,
        )[0]
        for count in (1, 2)
    )
    assert twice.covariance == pytest.approx(once.covariance, rel=1e-6)
    assert twice.gain == pytest.approx(once.gain)


def test_empty_maps_have_no_reading():
    look = look_at(points(AHEAD))
    nothing = seen(look, np.zeros((9, 20, 20), np.float32), np.zeros((16, 20, 20), np.float32))
    assert read(observation(), nothing, floor=True) == []
    assert read(observation(), nothing, floor=False) == []
