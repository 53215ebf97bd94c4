import math
from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pytest import approx

from rendezvous.errors import PipelineError
from rendezvous.geometry.camera import (
    PinholeCamera,
    camera_pose,
    rotation_from_rpy,
    se2_from_se3,
    se3_from_se2,
)
from rendezvous.geometry.se2 import SE2

D435 = PinholeCamera(fx_px=616.0, fy_px=616.0, cx_px=319.5, cy_px=239.5, width_px=640, height_px=480)
angles = st.floats(-3.0, 3.0)


def test_projection_agrees_with_opencv() -> None:
    p_c = np.random.default_rng(0).uniform([-1, -1, 0.5], [1, 1, 4.0], size=(50, 3))
    expected, _ = cv2.projectPoints(p_c, np.zeros(3), np.zeros(3), D435.K(), np.zeros(5))
    np.testing.assert_allclose(D435.project(p_c), expected[:, 0], atol=1e-9)


def test_a_camera_is_its_matrix_and_size() -> None:
    oblong = PinholeCamera(fx_px=610.0, fy_px=620.0, cx_px=300.0, cy_px=250.0, width_px=640, height_px=480)
    assert PinholeCamera.of_matrix(oblong.K(), 640, 480) == oblong


def test_a_point_behind_the_camera_is_nowhere_in_the_image() -> None:
    uv_px = D435.project(np.array([[0.0, 0.0, -1.0], [0.0, 0.0, 1.0]]))
    assert D435.in_image(uv_px).tolist() == [False, True]


def test_the_image_ends_half_a_pixel_beyond_its_outer_pixel_centres() -> None:
    uv_px = np.array([[-0.5, 0.0], [-0.51, 0.0], [639.49, 0.0], [639.5, 0.0], [0.0, 479.49], [0.0, 479.5]])
    assert D435.in_image(uv_px).tolist() == [True, False, True, False, True, False]


def test_the_d435_sees_55_by_43_degrees() -> None:
    across = 2 * math.degrees(math.atan(320 / D435.fx_px))
    down = 2 * math.degrees(math.atan(240 / D435.fy_px))
    assert (across, down) == (approx(55, abs=0.2), approx(43, abs=0.5))


def test_a_level_camera_looks_along_the_robots_x_axis() -> None:
    T_r_c = camera_pose(np.array([0.1, 0.0, 0.2]), np.zeros(3))
    np.testing.assert_allclose(T_r_c @ [0.0, 0.0, 2.0, 1.0], [2.1, 0.0, 0.2, 1.0], atol=1e-12)
    np.testing.assert_allclose(T_r_c @ [1.0, 0.0, 0.0, 1.0], [0.1, -1.0, 0.2, 1.0], atol=1e-12)
    np.testing.assert_allclose(T_r_c @ [0.0, 1.0, 0.0, 1.0], [0.1, 0.0, -0.8, 1.0], atol=1e-12)


@given(angles, angles, angles)
def test_roll_pitch_yaw_is_yaw_of_pitch_of_roll(roll: float, pitch: float, yaw: float) -> None:
    split = rotation_from_rpy(0, 0, yaw) @ rotation_from_rpy(0, pitch, 0) @ rotation_from_rpy(roll, 0, 0)
    R = rotation_from_rpy(roll, pitch, yaw)
    np.testing.assert_allclose(R, split, atol=1e-12)
    np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-12)


@given(angles, angles, angles)
def test_poses_on_the_floor_survive_the_round_trip(x: float, y: float, yaw: float) -> None:
    assert se2_from_se3(se3_from_se2(SE2(x, y, yaw))).as_array() == approx([x, y, yaw], abs=1e-12)


@pytest.mark.parametrize("wrong", ["fx_px", "fy_px", "width_px", "height_px"])
def test_a_camera_without_focal_length_or_size_is_refused(wrong: str) -> None:
    with pytest.raises(PipelineError, match="focal lengths and size must be positive"):
        replace(D435, **{wrong: 0})
