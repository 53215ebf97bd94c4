"""A virtual rendezvous of two stretches of one log, each mapped from scratch."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from rendezvous.exploration.records import Rendezvous, Snapshot
from rendezvous.exploration.rendezvous import Sighting
from rendezvous.geometry.camera import camera_pose
from rendezvous.geometry.se2 import SE2, Array
from rendezvous.recorded.laser_log import LaserLog
from rendezvous.recorded.mapped import LidarModel, map_scans
from rendezvous.recorded.meetings import Meeting
from rendezvous.recorded.odometry import DrawnOdometry, odometry_of
from rendezvous.simulation.robot import RobotSpec
from rendezvous.slam.slam import SlamParameters, compose, relative


def replayed(
    log: LaserLog,
    meeting: Meeting,
    robot: RobotSpec,
    *,
    lidar: LidarModel,
    slam: SlamParameters,
    noise: DrawnOdometry,
    rng: np.random.Generator,
) -> tuple[Rendezvous, tuple[SE2, SE2]]:
    """Run SLAM over both stretches.

    Returns:
        The rendezvous, in which robot 0 sees robot 1, and both true start poses, which are the map frames.
    """
    assert log.reference is not None, "meetings are drawn of logs with a reference"
    last_0, last_1 = meeting.scans_0[-1], meeting.scans_1[-1]
    # Relations are more accurate than the reference: robot 1's stretch is moved to where they have it.
    T_w_w1 = compose(compose(log.reference[last_0], meeting.T_r0_r1), _inverse(log.reference[last_1]))
    times_s = [np.abs(log.t_s[scans] - log.t_s[scans[0]]) for scans in (meeting.scans_0, meeting.scans_1)]
    t_s = max(float(times[-1]) for times in times_s)
    snapshots, starts = [], []
    for scans, times, moved, own_rng in zip(
        (meeting.scans_0, meeting.scans_1), times_s, (np.zeros(3), T_w_w1), rng.spawn(2), strict=True
    ):
        truth = np.array([compose(moved, pose) for pose in _unrolled(log.reference[scans])])
        snapshot, start = _snapshot(log, scans, times + (t_s - times[-1]), truth, lidar, slam, noise, own_rng)
        snapshots.append(snapshot)
        starts.append(start)
    event = Rendezvous(
        t_s=t_s,
        sightings=(_sighting(meeting.T_r0_r1, robot), None),
        snapshots=(snapshots[0], snapshots[1]),
    )
    return event, (starts[0], starts[1])


def _snapshot(
    log: LaserLog,
    scans: NDArray[np.int64],
    times_s: Array,
    truth: Array,
    lidar: LidarModel,
    slam: SlamParameters,
    noise: DrawnOdometry,
    rng: np.random.Generator,
) -> tuple[Snapshot, SE2]:
    """One robot at the end of its stretch, and its true pose at the start."""
    odometry = odometry_of(log, scans, noise, rng=rng)
    mapped = map_scans(log, scans, odometry, lidar=lidar, parameters=slam)
    # The map frame is where the first sweep began, the truth where it ended.
    began, ended = odometry[0]
    T_w_m = SE2.from_array(compose(truth[0], relative(ended, began)))
    snapshot = Snapshot(
        grid=mapped.grid,
        T_m_r=SE2.from_array(mapped.poses[-1]),
        T_m_r_odometry=SE2.from_array(relative(began, odometry[-1, 1])),
        T_w_r=SE2.from_array(truth[-1]),
        trajectory=np.column_stack([times_s, mapped.poses]),
        trajectory_w=np.column_stack([times_s, truth]),
    )
    return snapshot, T_w_m


def facing_camera(robot: RobotSpec, T_r0_r1: Array) -> Array:
    """(4, 4) pose of robot 0's camera, turned about the robot's axis until it faces robot 1."""
    camera, turn = robot.camera, math.atan2(T_r0_r1[1], T_r0_r1[0])
    xy_m = SE2(0.0, 0.0, turn) @ np.array(camera.xyz_m[:2])
    roll, pitch, yaw = camera.rpy_rad
    return camera_pose(np.array([*xy_m, camera.xyz_m[2]]), np.array([roll, pitch, yaw + turn]))


def _sighting(T_r0_r1: Array, robot: RobotSpec) -> Sighting:
    """Robot 0's camera faces robot 1, which nothing hides."""
    centre = SE2.from_array(T_r0_r1) @ np.array(robot.cuboid.centre_m[:2])
    eye = facing_camera(robot, T_r0_r1)[:3, 3]
    return Sighting(
        range_m=math.dist(eye, (*centre, robot.cuboid.centre_m[2])),
        bearing_rad=math.atan2(centre[1], centre[0]),
        visible_fraction=1.0,
    )


def _unrolled(poses: Array) -> Array:
    return np.column_stack([poses[:, :2], np.unwrap(poses[:, 2])])


def _inverse(pose: Array) -> Array:
    return SE2.from_array(pose).inverse().as_array()
