"""This project's SLAM over recorded scans, however the lidar is mounted."""

import numpy as np
import pytest

from rendezvous.geometry.occupancy_grid import FREE
from rendezvous.geometry.se2 import SE2
from rendezvous.recorded.mapped import LidarModel, map_scans
from rendezvous.recorded.odometry import DrawnOdometry, drawn_odometry
from rendezvous.slam.slam import SlamParameters
from tests.recorded.drive import BEARINGS_RAD, SEGMENTS_M, driven, laser_log


def _mapped(log, seed=0):
    order = np.arange(len(log), dtype=np.int64)
    odometry = drawn_odometry(log.reference, DrawnOdometry(), rng=np.random.default_rng(seed))
    return odometry, map_scans(
        log, order, np.stack([odometry, odometry], axis=1), lidar=LidarModel(), parameters=SlamParameters()
    )


def _share_of_walls_in_place(grid, start):
    """Share of the occupied cells that lie within 7 cm of a true wall."""
    p_w = SE2.from_array(start) @ grid.cell_centres(grid.occupied())
    a, b = SEGMENTS_M[:, :2], SEGMENTS_M[:, 2:]
    along = b - a
    t = ((p_w[:, None] - a) * along).sum(-1) / (along * along).sum(-1)
    nearest = a + np.clip(t, 0.0, 1.0)[..., None] * along
    return float((np.linalg.norm(p_w[:, None] - nearest, axis=-1).min(axis=1) < 0.07).mean())


@pytest.mark.parametrize(
    ("bearings_rad", "lidar_xy_m"),
    [
        (BEARINGS_RAD, (0.0, 0.0)),
        (BEARINGS_RAD + np.pi, (0.0, 0.0)),  # looks backwards
        (-BEARINGS_RAD, (0.25, 0.1)),  # upside down, away from the middle
        (np.deg2rad(np.arange(-135.0, 135.0, 0.5)), (-0.2, 0.0)),
    ],
)
def test_the_map_and_the_path_are_right_however_the_lidar_is_mounted(bearings_rad, lidar_xy_m):
    drive = driven(bearings_rad=bearings_rad, lidar_xy_m=lidar_xy_m)
    log = laser_log(drive, bearings_rad=bearings_rad, lidar_xy_m=lidar_xy_m)
    odometry, mapped = _mapped(log)
    T_m_w = SE2.from_array(drive.poses_w[0]).inverse()
    true = np.array([(T_m_w @ SE2.from_array(pose)).as_array() for pose in drive.poses_w])
    off_m = np.hypot(*(mapped.poses - true)[:, :2].T)
    assert off_m.max() < 0.08
    assert off_m[-1] < np.hypot(
        *(SE2.from_array(drive.poses_w[0]).inverse() @ odometry[-1, :2] - true[-1, :2])
    )
    assert _share_of_walls_in_place(mapped.grid, drive.poses_w[0]) > 0.9
    assert mapped.grid.T_m_g.yaw_rad == 0.0


def test_beams_without_a_measurement_clear_nothing_and_silent_ones_do():
    drive = driven(scans=6)
    order = np.arange(6, dtype=np.int64)
    still = np.zeros((6, 2, 3))
    for value, free in ((np.nan, False), (np.inf, True)):
        ranges_m = np.full((6, 180), value)
        ranges_m[:, :20] = drive.ranges_m[0, :20]
        log = laser_log(drive, ranges_m=ranges_m)
        grid = map_scans(log, order, still, lidar=LidarModel(), parameters=SlamParameters()).grid
        assert (grid.sample(np.array([2.0, 0.0])) == FREE) == free
        assert grid.sample(np.array([3.2, 0.0])) != FREE


def test_drawn_odometry_errs_by_its_share_of_the_way_and_the_same_for_a_seed():
    straight = np.column_stack([0.1 * np.arange(2001), np.zeros((2001, 2))])
    noise = DrawnOdometry(along=0.03, yaw_rad_per_m=0.0, yaw_per_rad=0.0)
    drawn = drawn_odometry(straight, noise, rng=np.random.default_rng(1))
    steps = np.diff(drawn[:, :2], axis=0)
    assert steps.std(axis=0) == pytest.approx([0.003, 0.003], rel=0.1)
    assert steps.mean(axis=0) == pytest.approx([0.1, 0.0], abs=3e-4)
    again = drawn_odometry(straight, noise, rng=np.random.default_rng(1))
    assert (again == drawn).all()
    turned = drawn_odometry(straight, DrawnOdometry(along=0.0), rng=np.random.default_rng(1))
    assert np.diff(turned[:, 2]).std() == pytest.approx(0.002, rel=0.1)


def test_an_empty_stretch_is_driven_by_odometry():
    drive = driven()
    ranges_m = drive.ranges_m.copy()
    ranges_m[20:30] = np.nan
    _, mapped = _mapped(laser_log(drive, ranges_m=ranges_m))
    T_m_w = SE2.from_array(drive.poses_w[0]).inverse()
    assert mapped.poses[-1, :2] == pytest.approx(T_m_w @ drive.poses_w[-1, :2], abs=0.15)
    assert _share_of_walls_in_place(mapped.grid, drive.poses_w[0]) > 0.8
