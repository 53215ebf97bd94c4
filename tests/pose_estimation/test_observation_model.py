from __future__ import annotations

import numpy as np
import pytest

from rendezvous.geometry.camera import se3_from_se2
from rendezvous.geometry.cuboid import project_cuboid
from rendezvous.geometry.se2 import SE2
from rendezvous.pose_estimation.observation_model import tilt_rotations
from tests.geometry.test_cuboid import random_pose
from tests.pose_estimation.observations import CAMERA, burger, observation, state


def test_a_level_camera_sees_what_the_chain_of_poses_says():
    before = observation(pitch_rad=0.2)
    T_c_o = before.T_c_o(np.array([1.5, 0.3, 2.0, 0.0, 0.0, 0.0]))
    T_r0_r1 = before.T_r0_c @ T_c_o @ np.linalg.inv(burger().T_r1_o)
    assert pytest.approx(se3_from_se2(SE2(1.5, 0.3, 2.0)), abs=1e-12) == T_r0_r1


def test_any_pose_is_one_setting():
    rng, before = np.random.default_rng(0), observation(pitch_rad=-0.3)
    for _ in range(50):
        near = state(rng)
        assert before.state(before.T_c_o(near)) == pytest.approx(near, abs=1e-9)
        T_c_o = random_pose(rng)
        assert before.T_c_o(before.state(T_c_o)) == pytest.approx(T_c_o, abs=1e-6)


def test_the_image_of_a_setting_is_that_of_its_cuboid():
    rng, before = np.random.default_rng(1), observation()
    states = np.array([state(rng) for _ in range(10)])
    for one, uv in zip(states, before.project(states), strict=True):
        assert uv == pytest.approx(project_cuboid(before.T_c_o(one), burger().size_m, CAMERA), abs=1e-9)


def test_the_jacobian_tells_where_points_go():
    rng, before = np.random.default_rng(2), observation()
    one, step = state(rng), 3e-4 * rng.normal(size=6)
    (J,) = before.jacobian(one[None])
    moved, still = before.project(np.stack([one + step, one]))
    assert J @ step == pytest.approx(moved - still, abs=5e-3)
    assert np.abs(moved - still).max() > 0.05


def test_a_camera_that_is_higher_sees_the_robot_lower():
    before = observation()
    level, higher = before.project(np.array([[2.0, 0.0, 0.0, h, 0.0, 0.0] for h in (0.0, 0.01)]))
    assert (higher[:, 1] - level[:, 1]) == pytest.approx(0.01 * 616.0 / 2.0, rel=0.1)


def test_turns_are_rotations_about_axes_in_the_floor():
    tilt = np.array([[0.3, -0.2], [0.0, 0.0], [np.pi / 2.0, 0.0]])
    R = tilt_rotations(tilt)
    assert R @ R.transpose(0, 2, 1) == pytest.approx(np.tile(np.eye(3), (3, 1, 1)), abs=1e-12)
    assert R[0] @ [0.3, -0.2, 0.0] == pytest.approx([0.3, -0.2, 0.0])
    assert R[1] == pytest.approx(np.eye(3))
    assert R[2] @ [0.0, 1.0, 0.0] == pytest.approx([0.0, 0.0, 1.0], abs=1e-12)
