"""A recorded laser log: what the robot's lidar and odometry said, and where a reference says that it was."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rendezvous.errors import LogError
from rendezvous.geometry.se2 import Array


@dataclass(frozen=True, slots=True, kw_only=True)
class LaserLog:
    """The scans of one robot in the order in which it drove, all of one planar lidar."""

    source: str  # its file, for messages
    t_s: Array  # (N,) rising; when each scan ended
    ranges_m: Array  # (N, B) inf for no echo, NaN for no measurement
    bearings_rad: Array  # (B,) of the beams in the order of shooting, from the robot's heading, left positive
    lidar_xy_m: tuple[float, float]  # where the lidar is on the robot
    range_max_m: float
    # odometry, odometry_start: (N, 3) x, y [m], yaw [rad] in the odometry frame as each scan ended and began.
    odometry: Array | None
    odometry_start: Array | None
    reference: Array | None  # (N, 3) the robot's poses by a better method, as each scan ended
    notes: tuple[str, ...] = ()  # what was found wrong and put right

    def __post_init__(self) -> None:
        count, beams = self.ranges_m.shape
        if count < 2 or not beams:
            raise LogError(
                f"{self.source}: {count} usable scans of {beams} beams; a log needs two scans or more"
            )
        if self.odometry is None and self.reference is None:
            raise LogError(f"{self.source}: neither odometry nor reference poses; SLAM needs one of them")
        assert self.t_s.shape == (count,), "a stamp for each scan"
        assert (np.diff(self.t_s) > 0.0).all(), "stamps rise"
        assert self.bearings_rad.shape == (beams,), "a bearing for each beam"
        assert (self.odometry is None) == (self.odometry_start is None), "both or neither"

    def __len__(self) -> int:
        return len(self.t_s)

    def path(self) -> Array:
        """(N, 3) the best poses there are: the reference's, else odometry's."""
        poses = self.odometry if self.reference is None else self.reference
        assert poses is not None, "a log has one of them"
        return poses

    def travelled_m(self) -> Array:
        """(N,) length of the path up to each scan [m]."""
        steps = np.hypot(*np.diff(self.path()[:, :2], axis=0).T)
        return np.concatenate([[0.0], np.cumsum(steps)])
