"""ROS bags of both generations, written with `rosbags`."""

import math

import numpy as np
import pytest

from rendezvous.errors import LogError, SetupError
from rendezvous.interop.laser_logs import read_laser_log
from rendezvous.interop.ros_bag import read_ros_bag
from tests.recorded.drive import driven

pytest.importorskip("rosbags")

from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

_DRIVE = driven(scans=10)
_ANGLES_RAD = np.deg2rad(np.arange(-90.0, 90.0, 1.0))
_SCAN, _ODOMETRY, _TF = "sensor_msgs/msg/LaserScan", "nav_msgs/msg/Odometry", "tf2_msgs/msg/TFMessage"


class Bag:
    """Messages to be written: (topic, type, when received, make)."""

    def __init__(self, kind: str) -> None:
        self.kind = kind
        self.store = get_typestore(Stores.ROS1_NOETIC if kind == "bag" else Stores.ROS2_HUMBLE)
        if kind == "bag":  # these types are not ROS 1's own
            definition = "geometry_msgs/TransformStamped[] transforms"
            self.store.register(get_types_from_msg(definition, _TF))
        self._messages = []

    def _t(self, name):
        return self.store.types[name]

    def header(self, stamp_s, frame):
        nanoseconds = round(stamp_s * 1e9)
        stamp = self._t("builtin_interfaces/msg/Time")(sec=nanoseconds // 10**9, nanosec=nanoseconds % 10**9)
        own = {"seq": 0} if self.kind == "bag" else {}
        return self._t("std_msgs/msg/Header")(stamp=stamp, frame_id=frame, **own)

    def add(self, topic, name, received_s, message):
        self._messages.append((topic, name, received_s, message))

    def scan(self, t, ranges_m, *, topic="/scan", received_s=None, **fields):
        given = {
            "angle_min": _ANGLES_RAD[0],
            "angle_max": _ANGLES_RAD[-1],
            "angle_increment": math.radians(1.0),
            "time_increment": 0.0,
            "scan_time": 0.1,
            "range_min": 0.1,
            "range_max": 20.0,
        } | fields
        message = self._t(_SCAN)(
            header=self.header(t, "laser"),
            ranges=np.asarray(ranges_m, np.float32),
            intensities=np.zeros(0, np.float32),
            **given,
        )
        self.add(topic, _SCAN, t if received_s is None else received_s, message)

    def odometry(self, t, pose, *, received_s=None):
        names = self._t
        zero = names("geometry_msgs/msg/Vector3")(x=0.0, y=0.0, z=0.0)
        x, y, yaw = pose
        position = names("geometry_msgs/msg/Point")(x=x, y=y, z=0.0)
        turn = names("geometry_msgs/msg/Quaternion")(x=0.0, y=0.0, z=math.sin(yaw / 2), w=math.cos(yaw / 2))
        at = names("geometry_msgs/msg/Pose")(position=position, orientation=turn)
        twist = names("geometry_msgs/msg/Twist")(linear=zero, angular=zero)
        message = names(_ODOMETRY)(
            header=self.header(t, "odom"),
            child_frame_id="base_link",
            pose=names("geometry_msgs/msg/PoseWithCovariance")(pose=at, covariance=np.zeros(36)),
            twist=names("geometry_msgs/msg/TwistWithCovariance")(twist=twist, covariance=np.zeros(36)),
        )
        self.add("/odom", _ODOMETRY, t if received_s is None else received_s, message)

    def transform(self, t, parent, child, xyz, quat_xyzw, topic="/tf_static"):
        names = self._t
        x, y, z, w = quat_xyzw
        one = names("geometry_msgs/msg/TransformStamped")(
            header=self.header(t, parent),
            child_frame_id=child,
            transform=names("geometry_msgs/msg/Transform")(
                translation=names("geometry_msgs/msg/Vector3")(x=xyz[0], y=xyz[1], z=xyz[2]),
                rotation=names("geometry_msgs/msg/Quaternion")(x=x, y=y, z=z, w=w),
            ),
        )
        self.add(topic, _TF, t, names(_TF)(transforms=[one]))

    def write(self, folder):
        path = folder / ("drive.bag" if self.kind == "bag" else "drive")
        plugin = StoragePlugin.MCAP if self.kind == "mcap" else StoragePlugin.SQLITE3
        writer = Writer1(path) if self.kind == "bag" else Writer2(path, version=9, storage_plugin=plugin)
        with writer:
            connections = {}
            for topic, name, received_s, message in self._messages:
                if topic not in connections:
                    connections[topic] = writer.add_connection(topic, name, typestore=self.store)
                serialize = self.store.serialize_ros1 if self.kind == "bag" else self.store.serialize_cdr
                writer.write(connections[topic], round(received_s * 1e9), serialize(message, name))
        return path


_UPRIGHT, _HALF_TURN, _UPSIDE_DOWN = (0.0, 0.0, 0.0, 1.0), (0.0, 0.0, 1.0, 0.0), (1.0, 0.0, 0.0, 0.0)
_TILTED = (0.0, math.sin(math.radians(15.0)), 0.0, math.cos(math.radians(15.0)))


def _bag(kind="mcap", *, quat_xyzw=_UPRIGHT, ranges_m=_DRIVE.ranges_m, mounted=True, odometry=True, **fields):
    bag = Bag(kind)
    if mounted:
        bag.transform(100.0, "base_link", "mast", (0.1, 0.0, 0.2), _UPRIGHT)
        bag.transform(100.0, "mast", "laser", (0.1, 0.05, 0.1), quat_xyzw)
    for t, pose, ranges in zip(_DRIVE.t_s, _DRIVE.poses_w, ranges_m, strict=True):
        if odometry:
            bag.odometry(float(t), pose)
        bag.scan(float(t), ranges, **fields)
    return bag


@pytest.mark.parametrize("kind", ["bag", "sqlite3", "mcap"])
def test_all_kinds_of_bags_give_the_same_log(tmp_path, kind):
    log = read_laser_log(_bag(kind).write(tmp_path))
    assert log.ranges_m == pytest.approx(_DRIVE.ranges_m, abs=1e-5)
    assert log.odometry == pytest.approx(_DRIVE.poses_w, abs=1e-9)
    assert log.t_s == pytest.approx(_DRIVE.t_s)
    assert log.bearings_rad == pytest.approx(_ANGLES_RAD, abs=1e-4)
    assert log.lidar_xy_m == pytest.approx((0.2, 0.05))
    assert log.range_max_m == 20.0
    assert log.notes == ()


@pytest.mark.parametrize("suffix", ["db3", "mcap"])
def test_the_file_in_a_bags_folder_is_read_too(tmp_path, suffix):
    folder = _bag("mcap" if suffix == "mcap" else "sqlite3").write(tmp_path)
    assert len(read_laser_log(folder / f"drive.{suffix}")) == 10


def test_a_lidar_mounted_backwards_has_turned_bearings(tmp_path):
    log = read_ros_bag(_bag(quat_xyzw=_HALF_TURN).write(tmp_path))
    off = np.remainder(log.bearings_rad - _ANGLES_RAD - math.pi + 1.0, 2.0 * math.pi) - 1.0
    assert off == pytest.approx(np.zeros(180), abs=1e-4)


def test_a_lidar_upside_down_turns_the_other_way(tmp_path):
    log = read_ros_bag(_bag(quat_xyzw=_UPSIDE_DOWN).write(tmp_path))
    assert log.bearings_rad == pytest.approx(-_ANGLES_RAD, abs=1e-4)


def test_a_tilted_lidar_is_one_line(tmp_path):
    with pytest.raises(LogError, match="its lidar is tilted by 30°; must be level, upright or upside down"):
        read_ros_bag(_bag(quat_xyzw=_TILTED).write(tmp_path))


def test_readings_that_are_none_are_told_apart(tmp_path):
    ranges_m = _DRIVE.ranges_m.copy()
    ranges_m[:, :5] = [0.0, np.nan, np.inf, 20.0, 0.05]
    log = read_ros_bag(_bag(ranges_m=ranges_m).write(tmp_path))
    np.testing.assert_array_equal(log.ranges_m[0, :5], [np.nan, np.nan, np.inf, np.inf, np.nan])


def test_a_turning_lidar_has_odometry_at_both_ends_of_a_sweep(tmp_path):
    log = read_ros_bag(_bag(time_increment=0.25 / 179).write(tmp_path))
    assert log.t_s == pytest.approx(_DRIVE.t_s + 0.25)
    assert log.odometry_start == pytest.approx(_DRIVE.poses_w, abs=1e-6)
    half_way = 0.5 * (_DRIVE.poses_w[:-1] + _DRIVE.poses_w[1:])
    assert log.odometry[:-1] == pytest.approx(half_way, abs=1e-6)


def test_without_transforms_the_pose_of_the_lidar_must_be_given(tmp_path):
    path = _bag(mounted=False).write(tmp_path)
    with pytest.raises(LogError, match="no fixed transforms from 'base_link' to the lidar's 'laser'"):
        read_ros_bag(path)
    log = read_ros_bag(path, lidar_pose=(0.3, 0.0, 0.1, math.pi, 0.0, 0.0))
    assert log.lidar_xy_m == (0.3, 0.0)
    assert log.bearings_rad == pytest.approx(-_ANGLES_RAD, abs=1e-4)


def test_odometry_may_be_a_transform(tmp_path):
    bag = _bag(odometry=False)
    for t, (x, y, yaw) in zip(_DRIVE.t_s, _DRIVE.poses_w, strict=True):
        quat = (0.0, 0.0, math.sin(yaw / 2), math.cos(yaw / 2))
        bag.transform(float(t), "odom", "base_link", (x, y, 0.0), quat, topic="/tf")
    log = read_ros_bag(bag.write(tmp_path))
    assert log.odometry == pytest.approx(_DRIVE.poses_w, abs=1e-9)
    assert log.lidar_xy_m == pytest.approx((0.2, 0.05))


def test_without_odometry_a_bag_is_one_line(tmp_path):
    with pytest.raises(LogError, match="no odometry: no nav_msgs/Odometry, and no transform in which"):
        read_ros_bag(_bag(odometry=False).write(tmp_path))


def test_where_stamps_jump_back_the_time_of_receipt_stands_for_them(tmp_path):
    bag = Bag("mcap")
    bag.transform(100.0, "base_link", "laser", (0.0, 0.0, 0.1), _UPRIGHT)
    for i, (t, pose, ranges) in enumerate(zip(_DRIVE.t_s, _DRIVE.poses_w, _DRIVE.ranges_m, strict=True)):
        stamp = float(t) - (60.0 if i >= 5 else 0.0)
        bag.odometry(stamp, pose, received_s=float(t))
        bag.scan(stamp, ranges, received_s=float(t))
    log = read_ros_bag(bag.write(tmp_path))
    assert log.t_s == pytest.approx(_DRIVE.t_s)
    assert log.odometry == pytest.approx(_DRIVE.poses_w, abs=1e-9)
    assert log.notes == ("stamps are missing or jump back; when messages were received stands for them",)


def test_a_stretch_without_odometry_is_left_out(tmp_path):
    bag = Bag("mcap")
    bag.transform(100.0, "base_link", "laser", (0.0, 0.0, 0.1), _UPRIGHT)
    for i, (t, pose, ranges) in enumerate(zip(_DRIVE.t_s, _DRIVE.poses_w, _DRIVE.ranges_m, strict=True)):
        if i not in (4, 5, 6):
            bag.odometry(float(t), pose)
        bag.scan(float(t), ranges)
    log = read_ros_bag(bag.write(tmp_path))
    assert len(log) == 6
    assert log.notes == ("4 scans that odometry does not cover are left out",)


def test_scans_of_other_beams_take_the_nearest(tmp_path):
    bag = _bag()
    bag.odometry(105.0, _DRIVE.poses_w[-1])
    every_second = _DRIVE.ranges_m[-1][::2]
    bag.scan(105.0, every_second, angle_increment=math.radians(2.0))
    log = read_ros_bag(bag.write(tmp_path))
    assert log.ranges_m[-1, ::2] == pytest.approx(every_second, abs=1e-5)
    assert log.notes == ("1 scans of other beams than most have the nearest beams' readings",)


def test_of_several_lidars_one_must_be_named(tmp_path):
    bag = _bag()
    for t, ranges in zip(_DRIVE.t_s, _DRIVE.ranges_m, strict=True):
        bag.scan(float(t), 2.0 * ranges, topic="/back")
    path = bag.write(tmp_path)
    with pytest.raises(LogError, match="scans on several topics: /back, /scan; --topic names one"):
        read_ros_bag(path)
    with pytest.raises(LogError, match="no scans on '/front', topics with scans are /back, /scan"):
        read_ros_bag(path, topic="/front")
    assert read_ros_bag(path, topic="/back").ranges_m[0, 90] == pytest.approx(2.0 * _DRIVE.ranges_m[0, 90])


@pytest.mark.parametrize("name", ["drive.bag", "drive.db3", "drive.mcap"])
@pytest.mark.parametrize("content", [b"", b"junk", b"#ROSBAG V2.0\nxx", b"\x89MCAP0\r\n"])
def test_what_is_no_bag_is_one_line(tmp_path, name, content):
    (tmp_path / name).write_bytes(content)
    with pytest.raises(LogError, match="must be a bag of ROS 1 or ROS 2"):
        read_ros_bag(tmp_path / name)


def test_a_missing_bag_and_one_without_scans_are_one_line(tmp_path):
    with pytest.raises(
        LogError, match=r"none.bag: no such file or directory; must be a bag of ROS 1 or ROS 2"
    ):
        read_ros_bag(tmp_path / "none.bag")
    bag = Bag("mcap")
    bag.odometry(1.0, (0.0, 0.0, 0.0))
    with pytest.raises(LogError, match="no scans; must be a bag"):
        read_ros_bag(bag.write(tmp_path))


def test_without_rosbags_the_extra_is_named(tmp_path, monkeypatch):
    import sys

    monkeypatch.setitem(sys.modules, "rosbags.highlevel", None)
    with pytest.raises(SetupError, match=r"reading ROS bags needs rosbags.*rendezvous-fusion\[ros\]"):
        read_ros_bag(tmp_path / "drive.bag")
