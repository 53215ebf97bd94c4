"""Laser logs in bags of ROS 1 (`.bag`) and ROS 2 (sqlite3 or MCAP), read with `rosbags`: no ROS is needed.

Read are `sensor_msgs/LaserScan`, odometry from `nav_msgs/Odometry` or else from the transform in which the
robot's base moves, and from `/tf_static` and `/tf` how the lidar sits on the robot. The stamp of a scan is
that of its first beam.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rendezvous.errors import LogError, needs_extra
from rendezvous.geometry.camera import rotation_from_rpy
from rendezvous.geometry.se2 import Array
from rendezvous.interop.ros_frames import Frames, level_bearings, matrix_of, mounting, planar
from rendezvous.recorded.laser_log import LaserLog
from rendezvous.recorded.repair import readings, rising_stamps

SUFFIXES = (".bag", ".db3", ".mcap")
RIGHT = "a bag of ROS 1 or ROS 2 with sensor_msgs/LaserScan"
_SCAN, _ODOMETRY = "sensor_msgs/msg/LaserScan", "nav_msgs/msg/Odometry"
_TRANSFORMS = ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")
_JUMP_S = 1.0  # stamps that fall by more were set back
_LONGEST_SWEEP_S = 1.0  # a longer one is a driver's mistake
_MOST_GAP_S = 1.0  # between two poses of odometry that a scan may lie between


@dataclass(slots=True)
class _Stamped:
    """Messages of one topic, with their own stamps and when they were received [s]."""

    messages: list[Any] = field(default_factory=list)
    own_s: list[float] = field(default_factory=list)
    received_s: list[float] = field(default_factory=list)
    base: str = ""  # of odometry: the frame whose pose it is

    def add(self, message: Any, own_s: float, received_s: float) -> None:
        self.messages.append(message)
        self.own_s.append(own_s)
        self.received_s.append(received_s)

    def has_sound_clock(self) -> bool:
        """Whether the stamps are set and never jump back."""
        own_s = np.array(self.own_s)
        return bool(own_s.any() and (np.diff(own_s) > -_JUMP_S).all())


@dataclass(slots=True, kw_only=True)
class _Bag:
    """What was read of a bag, by topic."""

    source: str
    scans: dict[str, _Stamped] = field(default_factory=lambda: defaultdict(_Stamped))
    odometry: dict[str, _Stamped] = field(default_factory=lambda: defaultdict(_Stamped))  # (3,) poses
    frames: Frames = field(default_factory=Frames)


def is_ros_bag(path: Path) -> bool:
    """Whether a path names a bag: a file with its suffix, or a folder, as ROS 2's bags are."""
    return path.suffix.lower() in SUFFIXES or path.is_dir()


def read_ros_bag(
    path: Path,
    *,
    topic: str | None = None,
    lidar_pose: Sequence[float] | None = None,
    range_max_m: float | None = None,
) -> LaserLog:
    """Read the lidar of a bag.

    Args:
        path: `.bag`, the folder of a ROS 2 bag, or its `.db3` or `.mcap` file.
        topic: of the scans; may be left out if there is one.
        lidar_pose: x, y, z [m], roll, pitch, yaw [rad] of the lidar on the robot, instead of the bag's
            transforms.
        range_max_m: from there on a reading is no echo; by default as the messages say.

    Raises:
        LogError: it cannot be read, has no scans or no odometry, or does not say how the lidar sits.
        SetupError: `rosbags` is not installed.
    """
    bag = _read(path)
    scans = _scans(bag, topic)
    first = scans.messages[0]
    sensor = first.header.frame_id.lstrip("/")
    odometry = _odometry(bag, sensor)
    T_r_l = (
        mounting(bag.frames, odometry.base, sensor, bag.source) if lidar_pose is None else _given(lidar_pose)
    )
    angles_rad, ranges_m, notes = _one_geometry(scans.messages)
    most_m = float(first.range_max) if range_max_m is None else range_max_m
    kept, t_s, odometry_s, poses = _on_one_clock(scans, odometry, notes)
    sweep_s = _sweep_s(first, len(angles_rad), notes)
    return LaserLog(
        source=str(path),
        t_s=t_s + sweep_s,
        ranges_m=readings(ranges_m[kept], range_min_m=float(first.range_min), range_max_m=most_m),
        bearings_rad=level_bearings(angles_rad, T_r_l, bag.source),
        lidar_xy_m=(float(T_r_l[0, 3]), float(T_r_l[1, 3])),
        range_max_m=most_m,
        odometry=_interpolated(t_s + sweep_s, odometry_s, poses),
        odometry_start=_interpolated(t_s, odometry_s, poses),
        reference=None,
        notes=tuple(notes),
    )


def _on_one_clock(
    scans: _Stamped, odometry: _Stamped, notes: list[str]
) -> tuple[NDArray[np.int64], Array, Array, Array]:
    """Indices and times [s] of the scans that odometry covers; times and poses of odometry, in order."""
    sound = scans.has_sound_clock() and odometry.has_sound_clock()
    if not sound:
        notes.append("stamps are missing or jump back; when messages were received stands for them")
    kept, t_s, repaired = rising_stamps(np.array(scans.own_s if sound else scans.received_s))
    notes += repaired
    odometry_s = np.array(odometry.own_s if sound else odometry.received_s)
    order = np.argsort(odometry_s, kind="stable")
    covered = _covered(t_s, odometry_s[order])
    if not covered.all():
        notes.append(f"{np.count_nonzero(~covered)} scans that odometry does not cover are left out")
    return kept[covered], t_s[covered], odometry_s[order], np.array(odometry.messages)[order]


def _read(path: Path) -> _Bag:
    """All scans, odometry and transforms of a bag."""
    bag = _Bag(source=str(path))
    for topic, kind, message, received_s in _messages(path):
        _add(bag, topic, kind, message, received_s)
    return bag


def _messages(path: Path) -> list[tuple[str, str, Any, float]]:
    """Topic, type, content and time of receipt [s] of each message that is of use."""
    with needs_extra("ros", "reading ROS bags"):
        from rosbags.highlevel import AnyReader
        from rosbags.typesys import Stores, get_typestore
    if not path.exists():
        raise LogError(f"{path}: no such file or directory; must be {RIGHT}")
    try:
        with AnyReader([path], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader:
            wanted = [c for c in reader.connections if c.msgtype in (_SCAN, _ODOMETRY, *_TRANSFORMS)]
            if not wanted:
                return []
            return [
                (c.topic, c.msgtype, reader.deserialize(data, c.msgtype), 1e-9 * received_ns)
                for c, received_ns, data in reader.messages(connections=wanted)
            ]
    except Exception as error:  # damaged bags make rosbags raise errors of many kinds
        reason = " ".join(str(getattr(error, "strerror", None) or error).split())
        raise LogError(f"{path}: {reason.rstrip('.') or type(error).__name__}; must be {RIGHT}") from error


def _add(bag: _Bag, topic: str, kind: str, message: Any, received_s: float) -> None:
    if kind == _SCAN:
        bag.scans[topic].add(message, _stamp_s(message.header), received_s)
    elif kind == _ODOMETRY:
        pose = message.pose.pose
        of_topic = bag.odometry[topic]
        of_topic.base = message.child_frame_id.lstrip("/")
        T = matrix_of(_xyz(pose.position), _quaternion(pose.orientation))
        of_topic.add(planar(T), _stamp_s(message.header), received_s)
    else:
        for one in message.transforms:
            T = matrix_of(_xyz(one.transform.translation), _quaternion(one.transform.rotation))
            bag.frames.add(one.header.frame_id, one.child_frame_id, (_stamp_s(one.header), received_s), T)


def _scans(bag: _Bag, topic: str | None) -> _Stamped:
    topics = ", ".join(sorted(bag.scans)) or "none"
    if topic is None and len(bag.scans) == 1:
        return next(iter(bag.scans.values()))
    if topic is None and bag.scans:
        raise LogError(f"{bag.source}: scans on several topics: {topics}; --topic names one")
    if topic not in bag.scans:
        asked = f"no scans on {topic!r}, topics with scans are {topics}" if topic else "no scans"
        raise LogError(f"{bag.source}: {asked}; must be {RIGHT}")
    return bag.scans[topic]


def _odometry(bag: _Bag, sensor: str) -> _Stamped:
    """The robot's poses: those of the topic with most, or else the transform that moves."""
    if bag.odometry:
        chosen = max(bag.odometry.values(), key=lambda of_topic: len(of_topic.messages))
        chosen.base = chosen.base or bag.frames.moving_base(sensor) or sensor
        return chosen
    base = bag.frames.moving_base(sensor)
    if base is None:
        raise LogError(
            f"{bag.source}: no odometry: no nav_msgs/Odometry, and no transform in which the robot with its "
            f"lidar {sensor!r} moves"
        )
    own_s, received_s = np.array(bag.frames.stamps_s[base]).T.tolist()
    return _Stamped([planar(T) for T in bag.frames.transforms[base]], own_s, received_s, base)


def _one_geometry(scans: Sequence[Any]) -> tuple[Array, Array, list[str]]:
    """(B,) angles of the beams in the lidar's frame, (N, B) ranges in metres, and what was done.

    Scans of other beams than most have the reading of the nearest beam, or none.
    """
    shapes = [
        (len(s.ranges), round(float(s.angle_min), 5), round(float(s.angle_increment), 7)) for s in scans
    ]
    (beams, first_rad, step_rad), count = Counter(shapes).most_common(1)[0]
    ranges_m = np.full((len(scans), beams), np.nan)
    angles_rad = first_rad + step_rad * np.arange(beams, dtype=np.float64)
    for row, scan, shape in zip(ranges_m, scans, shapes, strict=True):
        given = np.asarray(scan.ranges, dtype=np.float64)
        if shape == (beams, first_rad, step_rad):
            row[:] = given
        elif len(given) and scan.angle_increment:
            nearest = np.rint((angles_rad - scan.angle_min) / scan.angle_increment).astype(np.int64)
            there = (nearest >= 0) & (nearest < len(given))
            row[there] = given[nearest[there]]
    others = len(scans) - count
    notes = [f"{others} scans of other beams than most have the nearest beams' readings"] if others else []
    return angles_rad, ranges_m, notes


def _sweep_s(scan: Any, beams: int, notes: list[str]) -> float:
    """How long a scan takes from its first beam to its last."""
    sweep_s = max(0.0, float(scan.time_increment)) * (beams - 1)
    if sweep_s <= _LONGEST_SWEEP_S:
        return sweep_s
    notes.append(f"a scan of {sweep_s:.3g} s is none: scans are taken as made at once")
    return 0.0


def _covered(t_s: Array, known_s: Array) -> NDArray[np.bool_]:
    """(N,) whether there are poses close before and after each moment."""
    after = np.clip(np.searchsorted(known_s, t_s), 1, max(len(known_s) - 1, 1))
    if len(known_s) < 2:
        return np.zeros(len(t_s), np.bool_)
    near = known_s[after] - known_s[after - 1] <= _MOST_GAP_S
    slack_s = _MOST_GAP_S
    return near & (t_s >= known_s[0] - slack_s) & (t_s <= known_s[-1] + slack_s)


def _interpolated(t_s: Array, known_s: Array, poses: Array) -> Array:
    """(N, 3) poses at these moments, those at the ends beyond them."""
    if not len(t_s):
        return np.zeros((0, 3))
    yaw = np.unwrap(poses[:, 2])
    return np.column_stack([np.interp(t_s, known_s, column) for column in (poses[:, 0], poses[:, 1], yaw)])


def _given(lidar_pose: Sequence[float]) -> Array:
    T_r_l = np.eye(4)
    T_r_l[:3, :3] = rotation_from_rpy(*lidar_pose[3:])
    T_r_l[:3, 3] = lidar_pose[:3]
    return T_r_l


def _stamp_s(header: Any) -> float:
    return float(header.stamp.sec + 1e-9 * header.stamp.nanosec)


def _xyz(vector: Any) -> tuple[float, float, float]:
    return float(vector.x), float(vector.y), float(vector.z)


def _quaternion(q: Any) -> tuple[float, float, float, float]:
    return float(q.x), float(q.y), float(q.z), float(q.w)
