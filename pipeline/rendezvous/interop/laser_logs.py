"""A recorded laser log of any format that can be read."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from rendezvous.errors import LogError
from rendezvous.interop.carmen_log import PosesOf, read_carmen_log
from rendezvous.interop.ros_bag import is_ros_bag, read_ros_bag
from rendezvous.interop.trajectory_files import read_tum
from rendezvous.recorded.laser_log import LaserLog

_MOST_GAP_S = 2.0  # between two poses of a trajectory that a scan may lie between


def read_laser_log(
    path: Path,
    *,
    poses: PosesOf = PosesOf.AUTO,
    range_max_m: float | None = None,
    reference: Path | None = None,
    topic: str | None = None,
    lidar_pose: Sequence[float] | None = None,
) -> LaserLog:
    """Read a log.

    Args:
        path: a CARMEN log or a ROS bag.
        poses: what the poses in a CARMEN log are; by default that is found out.
        range_max_m: from there on a reading is no echo; by default as the log says, or found out.
        reference: a trajectory in TUM's format with the log's stamps, as the reference instead of the log's.
        topic: of the scans in a bag; may be left out if there is one.
        lidar_pose: x, y, z [m], roll, pitch, yaw [rad] of a bag's lidar on the robot; by default from its
            transforms.

    Raises:
        LogError: a file cannot be read or used.
        SetupError: a package that reads bags is not installed.
    """
    if is_ros_bag(path):
        log = read_ros_bag(path, topic=topic, lidar_pose=lidar_pose, range_max_m=range_max_m)
    else:
        log = read_carmen_log(path, poses=poses, range_max_m=range_max_m)
    return log if reference is None else with_reference(log, reference)


def with_reference(log: LaserLog, path: Path) -> LaserLog:
    """The log with poses interpolated in a TUM trajectory; scans that it does not cover are left out.

    Raises:
        LogError: the trajectory cannot be read, or covers fewer than two scans.
    """
    t_s, poses = read_tum(path)
    after = np.clip(np.searchsorted(t_s, log.t_s), 1, max(len(t_s) - 1, 1))
    if len(t_s) < 2:
        raise LogError(f"{path}: one pose; a reference needs two or more")
    inside = (log.t_s >= t_s[0]) & (log.t_s <= t_s[-1]) & (t_s[after] - t_s[after - 1] <= _MOST_GAP_S)
    if np.count_nonzero(inside) < 2:
        raise LogError(
            f"{path}: its stamps, {t_s[0]:.3f} to {t_s[-1]:.3f} s, cover {np.count_nonzero(inside)} scans of "
            f"{log.source}, {log.t_s[0]:.3f} to {log.t_s[-1]:.3f} s; both must be of one clock"
        )
    yaw = np.unwrap(poses[:, 2])
    reference = np.column_stack(
        [
            np.interp(log.t_s, t_s, poses[:, 0]),
            np.interp(log.t_s, t_s, poses[:, 1]),
            np.interp(log.t_s, t_s, yaw),
        ]
    )
    return replace(
        log,
        t_s=log.t_s[inside],
        ranges_m=log.ranges_m[inside],
        reference=reference[inside],
        odometry=None if log.odometry is None else log.odometry[inside],
        odometry_start=None if log.odometry_start is None else log.odometry_start[inside],
    )


def log_name(path: Path) -> str:
    """A log's name: that of its file or folder without the suffixes of logs."""
    name = path.name
    for suffix in (".gz", ".log", ".clf", ".bag", ".db3", ".mcap"):
        name = name.removesuffix(suffix)
    return name


def log_digest(path: str) -> str:
    """SHA-256 of a file; of a folder, of the names and digests of its files.

    Raises:
        LogError: it cannot be read.
    """
    try:
        if not Path(path).is_dir():
            with open(path, "rb") as file:
                return hashlib.file_digest(file, "sha256").hexdigest()
        files = sorted(file for file in Path(path).iterdir() if file.is_file())
        lines = [f"{file.name} {log_digest(str(file))}\n" for file in files]
    except OSError as error:
        raise LogError(f"{path}: {(error.strerror or str(error)).lower()}; must be a recorded log") from error
    return hashlib.sha256("".join(lines).encode()).hexdigest()
