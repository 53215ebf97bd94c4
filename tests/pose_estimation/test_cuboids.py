from __future__ import annotations

import numpy as np
import pytest

from rendezvous.geometry.cuboid import project_cuboid
from rendezvous.pose_estimation.cuboids import detect_cuboids
from rendezvous.pose_estimation.dope_labels import belief_maps, vector_fields
from rendezvous.pose_estimation.peaks import Peaks, belief_peaks
from tests.geometry.test_cuboid import CAMERA, SIZE_M

STRIDE_PX = 8


def placed(x_m: float, yaw_rad: float, z_m: float = 1.0) -> np.ndarray:
    """(9, 2) [px] of a cuboid that stands upright before the camera."""
    c, s = np.cos(yaw_rad), np.sin(yaw_rad)
    T_c_o = np.eye(4)
    T_c_o[:3, :3] = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]]) @ np.array(
        [[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]
    )
    T_c_o[:3, 3] = x_m, 0.05, z_m
    return project_cuboid(T_c_o, SIZE_M, CAMERA)


def found(uv_N92, *, hidden=(), spurious=()):
    size = {"width_px": CAMERA.width_px, "height_px": CAMERA.height_px, "stride_px": STRIDE_PX}
    beliefs = belief_maps(uv_N92, **size, sigma_cells=1.0)
    fields = vector_fields(uv_N92, **size, radius_cells=2)
    beliefs[list(hidden)] = 0.0
    for channel, row, col in spurious:
        beliefs[channel, row, col] = 0.9
    return detect_cuboids(belief_peaks(beliefs, sigma_cells=1.0), fields)


def test_two_robots_are_told_apart():
    one, other = placed(-0.25, 0.5), placed(0.28, 2.0)
    several = found(np.stack([one, other]))
    assert len(several) == 2
    by_side = sorted(several, key=lambda cuboid: cuboid.uv_cells_92[8, 0])
    for cuboid, uv_px in zip(by_side, (one, other), strict=True):
        assert STRIDE_PX * cuboid.uv_cells_92 == pytest.approx(uv_px, abs=0.2)
        assert cuboid.score == pytest.approx(1.0, abs=0.02)


def test_a_missing_corner_is_missing_and_a_stray_one_is_not_taken():
    uv = placed(0.0, 0.5)
    (cuboid,) = found(uv[None], hidden=[2], spurious=[(2, 5, 5), (3, 5, 8)])
    assert np.isnan(cuboid.uv_cells_92[2]).all()
    assert cuboid.height_9[2] == 0.0
    rest = [i for i in range(9) if i != 2]
    assert STRIDE_PX * cuboid.uv_cells_92[rest] == pytest.approx(uv[rest], abs=0.2)


def test_a_cuboid_without_its_centroid_is_one_all_the_same():
    uv = placed(0.1, 1.0)
    (cuboid,) = found(uv[None], hidden=[8])
    assert STRIDE_PX * cuboid.uv_cells_92[:8] == pytest.approx(uv[:8], abs=0.2)
    assert STRIDE_PX * cuboid.span_cells == pytest.approx(np.ptp(uv[:8], axis=0).max(), abs=0.4)
    assert len(found(uv[None], hidden=[8, 0, 1, 2, 3])) == 1
    assert found(uv[None], hidden=[8, 0, 1, 2, 3, 4]) == []


@pytest.mark.parametrize(
    ("turn_rad", "away_cells", "own"),
    [(0.45, 4.0, True), (0.55, 4.0, False), (0.55, 0.9, True), (3, 1.1, False)],
)
def test_a_corner_belongs_to_the_centroid_that_its_vector_points_at_or_that_is_very_near(
    turn_rad: float, away_cells: float, own: bool
):
    uv = np.array([[10.0, 10.0], [10.0 + away_cells, 10.0]])
    peaks = Peaks(channel_P=np.array([2, 8]), uv_cells_P2=uv, height_P=np.array([0.9, 0.8]))
    fields = np.zeros((16, 20, 20), np.float32)
    fields[4], fields[5] = np.cos(turn_rad), np.sin(turn_rad)
    (cuboid,) = detect_cuboids(peaks, fields)
    assert np.isfinite(cuboid.uv_cells_92[2]).all() == own
    assert cuboid.score == pytest.approx((0.9 * own + 0.8) / 9.0)


def test_of_two_centroids_a_corner_goes_to_the_nearer_and_of_two_corners_the_higher_stays():
    uv = np.array([[10.0, 10.0], [10.0, 11.0], [16.0, 10.0], [13.0, 10.0]])
    peaks = Peaks(channel_P=np.array([2, 2, 8, 8]), uv_cells_P2=uv, height_P=np.array([0.5, 0.9, 1.0, 0.6]))
    fields = np.zeros((16, 20, 20), np.float32)
    fields[4] = 1.0
    first, second = sorted(detect_cuboids(peaks, fields), key=lambda cuboid: cuboid.uv_cells_92[8, 0])
    assert first.uv_cells_92[2].tolist() == [10.0, 11.0]
    assert np.isnan(second.uv_cells_92[2]).all()
    assert first.score == pytest.approx((0.9 + 0.6) / 9.0)


def test_empty_maps_hold_no_cuboid():
    assert found(np.empty((0, 9, 2))) == []


def test_a_vector_is_the_mean_of_the_cells_around_its_corner():
    """Cell (10, 10) points away, its eight neighbours to the centroid."""
    uv = np.array([[10.2, 9.8], [14.0, 10.0]])
    peaks = Peaks(channel_P=np.array([2, 8]), uv_cells_P2=uv, height_P=np.array([0.9, 0.8]))
    fields = np.zeros((16, 20, 20), np.float32)
    fields[4, 9:12, 9:12] = 1.0
    fields[4, 10, 10] = -1.0
    (cuboid,) = detect_cuboids(peaks, fields)
    assert np.isfinite(cuboid.uv_cells_92[2]).all()


def test_the_centre_is_that_of_the_box_around_the_points_that_were_found():
    uv = np.array([[2.0, 3.0], [10.0, 4.0], [3.0, 5.0]])
    peaks = Peaks(channel_P=np.array([0, 1, 8]), uv_cells_P2=uv, height_P=np.ones(3))
    fields = np.zeros((16, 20, 20), np.float32)
    fields[0, 3, 2], fields[1, 3, 2], fields[2, 4, 10] = 0.5, 1.0, -1.0
    (cuboid,) = detect_cuboids(peaks, fields)
    assert cuboid.centre_cells == pytest.approx([6.0, 4.0])
    assert cuboid.span_cells == 8.0
