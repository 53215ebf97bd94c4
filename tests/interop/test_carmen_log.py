"""CARMEN's logs."""

import gzip

import numpy as np
import pytest

from rendezvous.errors import LogError
from rendezvous.interop.carmen_log import PosesOf, read_carmen_log
from tests.recorded.drive import carmen_text, driven

_DRIVE = driven(scans=12)


def _written(tmp_path, text, name="drive.log"):
    path = tmp_path / name
    path.write_bytes(gzip.compress(text.encode()) if name.endswith(".gz") else text.encode())
    return path


@pytest.mark.parametrize("name", ["drive.log", "drive.clf", "drive.log.gz"])
def test_a_log_as_the_robot_wrote_it_has_odometry_and_no_reference(tmp_path, name):
    log = read_carmen_log(_written(tmp_path, carmen_text(_DRIVE), name))
    assert log.odometry == pytest.approx(_DRIVE.poses_w, abs=1e-6)
    assert log.reference is None
    assert log.ranges_m == pytest.approx(_DRIVE.ranges_m, abs=1e-6)
    assert log.t_s == pytest.approx(_DRIVE.t_s)
    assert np.rad2deg(log.bearings_rad) == pytest.approx(np.arange(-90.0, 90.0))
    assert log.notes == ()


def test_a_laser_before_the_robots_middle_is_found_by_its_poses(tmp_path):
    laser = _DRIVE.poses_w.copy()
    laser[:, 0] += 0.25 * np.cos(laser[:, 2])
    laser[:, 1] += 0.25 * np.sin(laser[:, 2])
    log = read_carmen_log(_written(tmp_path, carmen_text(_DRIVE, laser=laser)))
    assert log.lidar_xy_m == pytest.approx((0.25, 0.0), abs=1e-6)
    assert log.reference is None


def test_laser_poses_that_odometry_does_not_explain_are_the_reference(tmp_path):
    laser = _DRIVE.poses_w + np.linspace(0.0, 0.5, 12)[:, None]
    text = carmen_text(_DRIVE, laser=laser, head="PARAM robot_frontlaser_offset 0.1 nohost 0\n")
    log = read_carmen_log(_written(tmp_path, text))
    robot = laser[:, :2] - 0.1 * np.column_stack([np.cos(laser[:, 2]), np.sin(laser[:, 2])])
    assert log.reference[:, :2] == pytest.approx(robot, abs=1e-5)
    assert log.odometry == pytest.approx(_DRIVE.poses_w, abs=1e-6)
    assert log.lidar_xy_m == (0.1, 0.0)


@pytest.mark.parametrize(("head", "poses"), [("NEFF 30\n", PosesOf.AUTO), ("", PosesOf.REFERENCE)])
def test_a_log_that_went_through_slam_has_a_reference_and_no_odometry(tmp_path, head, poses):
    log = read_carmen_log(_written(tmp_path, carmen_text(_DRIVE, head=head)), poses=poses)
    assert log.odometry is None
    assert log.reference == pytest.approx(_DRIVE.poses_w, abs=1e-6)


def test_the_newer_message_says_what_its_laser_is(tmp_path):
    lines = [
        f"ROBOTLASER1 99 -1.0 2.0 0.5 6.0 0.01 0 5 1 2 0 nan 7 2 9 9 {i} 0 0 {i} 0 0 0 0 0 0 0 {i}.5 host 0\n"
        for i in range(3)
    ]
    log = read_carmen_log(_written(tmp_path, "".join(lines)))
    assert log.bearings_rad.tolist() == [-1.0, -0.5, 0.0, 0.5, 1.0]
    np.testing.assert_array_equal(log.ranges_m[0], [1.0, 2.0, np.nan, np.nan, np.inf])
    assert log.t_s.tolist() == [0.5, 1.5, 2.5]
    assert log.range_max_m == 6.0


def test_181_beams_reach_from_right_to_left(tmp_path):
    text = "".join(f"FLASER 181 {'2 ' * 181}{i} 0 0 {i} 0 0 {i} host {i}\n" for i in range(3))
    log = read_carmen_log(_written(tmp_path, text))
    assert np.rad2deg(log.bearings_rad[[0, 90, 180]]) == pytest.approx([-90.0, 0.0, 90.0])


def test_damaged_lines_and_scans_of_other_sizes_are_said(tmp_path):
    text = carmen_text(_DRIVE) + "FLASER 180 1 2 3\nFLASER many\n"
    text += "FLASER 2 1 1 0 0 0 0 0 0 200.0 host 0\nFLASER 1 1 0 0 nan 0 0 0 201.0 host 0\n"
    log = read_carmen_log(_written(tmp_path, text))
    assert len(log) == 13
    assert np.isnan(log.ranges_m[-1]).all()
    assert log.notes == ("1 scans of other than 180 beams are taken as empty", "3 damaged lines are left out")


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "no FLASER or ROBOTLASER1 line with ranges"),
        (b"\x00\xff" * 50, "no FLASER or ROBOTLASER1 line with ranges"),
        (b"FLASER 2 1 1 0 0 0 0 0 0 0 host 0\n", "1 usable scans of 2 beams; a log needs two scans or more"),
        (gzip.compress(carmen_text(_DRIVE).encode())[:-20], "the end of the gzipped text is missing"),
        (b"\x1f\x8b\x00damaged", "must be a CARMEN log"),
    ],
)
def test_what_is_no_log_is_one_line(tmp_path, content, message):
    path = tmp_path / "drive.log"
    path.write_bytes(content)
    with pytest.raises(LogError, match=message):
        read_carmen_log(path)


def test_a_missing_file_is_one_line(tmp_path):
    with pytest.raises(LogError, match="no such file or directory; must be a CARMEN log"):
        read_carmen_log(tmp_path / "none.log")


@pytest.mark.parametrize(
    ("name", "scans"), [("intel", 910), ("freiburg-101", 292), ("edmonton", 340), ("orebro", 237)]
)
def test_public_logs_are_read(real_data, name, scans):
    log = read_carmen_log(real_data / f"logs/{name}.log.gz")
    assert len(log) == scans
    assert log.odometry is None
    assert log.range_max_m < 82.0
    assert np.isinf(log.ranges_m).any()
