"""This project's SLAM over recorded scans."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from rendezvous.errors import require_within
from rendezvous.geometry.occupancy_grid import OccupancyGrid
from rendezvous.geometry.se2 import SE2, Array
from rendezvous.recorded.laser_log import LaserLog
from rendezvous.slam.slam import MOST_CELLS, LidarGeometry, LidarScan, Slam, SlamParameters, Sweep, compose

_MARGIN_M = 30.0  # mapped beyond the path on all sides
_NORMALS_TO_M = 20.0  # points nearer than this have normals, if they lie on a wall
_DRIFT = 1.1  # a map that drifts is larger than its odometry
_MOST_EXTENT_M = 400.0


@dataclass(frozen=True, slots=True, kw_only=True)
class LidarModel:
    """What a log does not say of its lidar."""

    sigma_m: float = 0.02  # of a range
    sigma_ratio: float = 0.002  # and what each metre adds to it
    no_echo_free_m: float = 3.0  # how far a beam clears the map if it and its neighbours have no echo

    def __post_init__(self) -> None:
        require_within(self, sigma_m=(0, 1), sigma_ratio=(0, 1), no_echo_free_m=(0, 100))


@dataclass(frozen=True, slots=True, kw_only=True)
class Mapped:
    """A stretch of a log after SLAM. Map frame: the robot's pose at its first scan."""

    grid: OccupancyGrid
    poses: Array  # (N, 3) x, y [m], yaw [rad] of the robot in its map, as each scan ended


class LogScans:
    """Some scans of a log as SLAM takes them.

    SLAM works in the frame s, which sits at the lidar with the robot's axes: a turned lidar only has turned
    bearings.
    """

    def __init__(
        self,
        log: LaserLog,
        order: NDArray[np.int64],
        odometry: Array,
        *,
        lidar: LidarModel,
        parameters: SlamParameters,
    ) -> None:
        """Arguments are as for `map_scans`."""
        self.T_r_s = np.array([*log.lidar_xy_m, 0.0])
        self._ranges_m, self._order = log.ranges_m, order
        self._odometry = odometry
        self.parameters = replace(
            parameters.with_normals(_step_rad(log.bearings_rad), to_m=_NORMALS_TO_M),
            extent_m=self.extent_m(odometry.reshape(-1, 3), parameters.mapping.resolution_m),
        )
        self.lidar = LidarGeometry(
            bearings_rad=log.bearings_rad,
            x_m=0.0,
            sigma=(lidar.sigma_m, lidar.sigma_ratio),
            no_echo_m=min(lidar.no_echo_free_m, 0.9 * log.range_max_m),
        )

    def __len__(self) -> int:
        return len(self._order)

    def odometry(self, i: int) -> Array:
        """(3,) odometry's pose of s as the i-th scan ended."""
        return compose(self._odometry[i, 1], self.T_r_s)

    def sweep(self, i: int) -> Sweep:
        """The sweep of the i-th scan."""
        knots = np.array([compose(pose, self.T_r_s) for pose in self._odometry[i]])
        return Sweep(ranges_m=self._ranges_m[self._order[i]], odometry=knots)

    def scan(self, i: int) -> LidarScan:
        """The i-th scan in the frame s at its end."""
        return self.lidar.scan(self.sweep(i), self.parameters)

    def of_robot(self, pose: Array) -> Array:
        """(3,) pose of the robot in its map, of that of s in the frame where s began."""
        return compose(compose(self.T_r_s, pose), -self.T_r_s)

    def map_of_robot(self, grid: OccupancyGrid) -> OccupancyGrid:
        """The same map in the robot's map frame."""
        return replace(grid, T_m_g=SE2.from_array(self.T_r_s) @ grid.T_m_g)

    @staticmethod
    def extent_m(path: Array, resolution_m: float) -> float:
        """Side of a square around the first pose that holds a path (N, 3) and what is seen from it."""
        reach_m = float(np.abs(path[:, :2] - path[0, :2]).max())
        most_m = min(_MOST_EXTENT_M, MOST_CELLS * resolution_m)
        return min(2.0 * (_DRIFT * reach_m + _MARGIN_M), most_m)


def map_scans(
    log: LaserLog,
    order: NDArray[np.int64],
    odometry: Array,
    *,
    lidar: LidarModel,
    parameters: SlamParameters,
) -> Mapped:
    """Run SLAM over some scans of a log from scratch.

    Args:
        log: the scans.
        order: (N,) indices of the scans, in the order in which they are taken.
        odometry: (N, 2, 3) the robot's pose in any one frame as each of them began and ended.
        lidar: what the log does not say.
        parameters: `extent_m` follows from the odometry's path, and `normal_radius_m` is at least what the
            lidar's step needs.
    """
    scans = LogScans(log, order, odometry, lidar=lidar, parameters=parameters)
    slam = Slam(
        bearings_rad=scans.lidar.bearings_rad,
        lidar_x_m=scans.lidar.x_m,
        lidar_sigma=scans.lidar.sigma,
        no_echo_m=scans.lidar.no_echo_m,
        parameters=scans.parameters,
    )
    poses = np.empty((len(scans), 3))
    for i in range(len(scans)):
        slam.update(scans.sweep(i))
        poses[i] = scans.of_robot(slam.pose())
    return Mapped(grid=scans.map_of_robot(slam.mapper.grid()), poses=poses)


def _step_rad(bearings_rad: Array) -> float:
    return float(np.median(np.abs(np.diff(bearings_rad)))) if len(bearings_rad) > 1 else 0.0
