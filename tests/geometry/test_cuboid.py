from __future__ import annotations

import cv2
import numpy as np
import pytest

from rendezvous.geometry.camera import PinholeCamera, rotation_from_rpy
from rendezvous.geometry.cuboid import cuboid_points, pose_from_cuboid, project_cuboid

CAMERA = PinholeCamera(fx_px=616.0, fy_px=610.0, cx_px=319.5, cy_px=239.5, width_px=640, height_px=480)
SIZE_M = (0.138, 0.178, 0.192)


def random_pose(rng: np.random.Generator) -> np.ndarray:
    """A cuboid anywhere in front of the camera, 0.3 to 4 m away, turned in any way."""
    T_c_o = np.eye(4)
    T_c_o[:3, :3] = rotation_from_rpy(*rng.uniform(-np.pi, np.pi, 3))
    z_m = rng.uniform(0.3, 4.0)
    T_c_o[:3, 3] = z_m * rng.uniform(-0.5, 0.5), z_m * rng.uniform(-0.4, 0.4), z_m
    return T_c_o


def error(T_a: np.ndarray, T_b: np.ndarray) -> tuple[float, float]:
    """Distance [m] and angle [rad] between two poses."""
    R = T_a[:3, :3].T @ T_b[:3, :3]
    sine = 0.5 * np.linalg.norm(R - R.T) / np.sqrt(2.0)
    return float(np.linalg.norm(T_a[:3, 3] - T_b[:3, 3])), float(np.arctan2(sine, 0.5 * (np.trace(R) - 1.0)))


def test_points_are_corners_of_the_cuboid_and_its_centre():
    points = cuboid_points(SIZE_M)
    assert np.array_equal(points[8], np.zeros(3))
    assert np.abs(points[:8]) == pytest.approx(np.tile(0.5 * np.array(SIZE_M), (8, 1)))
    assert len(np.unique(points[:8], axis=0)) == 8


def test_corners_are_in_the_order_of_dope():
    """Four corners at the top, then four at the bottom, each time round from front right."""
    front, back, left, right, top, bottom = 1.0, -1.0, 2.0, -2.0, 3.0, -3.0
    assert cuboid_points((2.0, 4.0, 6.0)).tolist() == [
        [front, right, top], [back, right, top], [back, left, top], [front, left, top],
        [front, right, bottom], [back, right, bottom], [back, left, bottom], [front, left, bottom],
        [0.0, 0.0, 0.0],
    ]  # fmt: skip


def test_projection_agrees_with_opencv():
    rng = np.random.default_rng(0)
    for _ in range(50):
        T_c_o = random_pose(rng)
        rvec, _ = cv2.Rodrigues(T_c_o[:3, :3])
        expected, _ = cv2.projectPoints(cuboid_points(SIZE_M), rvec, T_c_o[:3, 3], CAMERA.K(), None)
        assert project_cuboid(T_c_o, SIZE_M, CAMERA) == pytest.approx(expected.reshape(9, 2), abs=1e-6)


def test_pnp_on_the_points_returns_the_pose():
    rng = np.random.default_rng(1)
    for _ in range(200):
        T_c_o = random_pose(rng)
        found = pose_from_cuboid(project_cuboid(T_c_o, SIZE_M, CAMERA), SIZE_M, CAMERA)
        assert found is not None
        distance_m, angle_rad = error(T_c_o, found)
        assert distance_m < 1e-3
        assert angle_rad < np.radians(0.1)


def test_five_points_that_are_not_in_a_plane_are_enough():
    rng = np.random.default_rng(2)
    for _ in range(100):
        T_c_o = random_pose(rng)
        uv_px = project_cuboid(T_c_o, SIZE_M, CAMERA)
        uv_px[[2, 5, 6, 7]] = np.nan
        found = pose_from_cuboid(uv_px, SIZE_M, CAMERA)
        assert found is not None
        assert error(T_c_o, found)[0] < 1e-3


def test_three_points_are_too_few():
    uv_px = project_cuboid(random_pose(np.random.default_rng(3)), SIZE_M, CAMERA)
    uv_px[3:] = np.nan
    assert pose_from_cuboid(uv_px, SIZE_M, CAMERA) is None


def test_points_behind_the_camera_are_unknown():
    T_c_o = np.eye(4)
    T_c_o[2, 3] = 0.05
    unknown = np.isnan(project_cuboid(T_c_o, SIZE_M, CAMERA)).all(axis=1)
    assert np.array_equal(unknown, [False] * 4 + [True] * 4 + [False])


def test_four_points_that_are_not_in_a_plane_are_enough():
    T_c_o = np.eye(4)
    T_c_o[:3, :3] = rotation_from_rpy(0.4, -0.3, 1.0)
    T_c_o[:3, 3] = 0.1, -0.05, 1.0
    uv_px = project_cuboid(T_c_o, SIZE_M, CAMERA)
    uv_px[[2, 3, 5, 6, 7]] = np.nan
    found = pose_from_cuboid(uv_px, SIZE_M, CAMERA)
    assert found is not None
    assert project_cuboid(found, SIZE_M, CAMERA)[[0, 1, 4, 8]] == pytest.approx(uv_px[[0, 1, 4, 8]], abs=0.1)


def test_points_in_one_place_have_no_pose():
    assert pose_from_cuboid(np.full((9, 2), 100.0), SIZE_M, CAMERA) is None
