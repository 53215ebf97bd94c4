"""This project's SLAM over recorded scans."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from rendezvous.errors import require_within
from rendezvous.geometry.occupancy_grid import OccupancyGrid
from rendezvous.geometry.se2 import SE2, Array
from rendezvous.recorded.laser_log import LaserLog
from rendezvous.slam.slam import MOST_CELLS, Slam, SlamParameters, Sweep, compose

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
    # The frame s sits at the lidar with the robot's axes: a turned lidar only has turned bearings.
    T_r_s = np.array([*log.lidar_xy_m, 0.0])
    slam = Slam(
        bearings_rad=log.bearings_rad,
        lidar_x_m=0.0,
        lidar_sigma=(lidar.sigma_m, lidar.sigma_ratio),
        no_echo_m=min(lidar.no_echo_free_m, 0.9 * log.range_max_m),
        parameters=replace(
            parameters.with_normals(_step_rad(log.bearings_rad), to_m=_NORMALS_TO_M),
            extent_m=_extent_m(odometry, parameters.mapping.resolution_m),
        ),
    )
    poses = np.empty((len(order), 3))
    for i, scan in enumerate(order):
        knots = np.array([compose(pose, T_r_s) for pose in odometry[i]])
        slam.update(Sweep(ranges_m=log.ranges_m[scan], odometry=knots))
        poses[i] = compose(compose(T_r_s, slam.pose()), -T_r_s)
    grid = slam.mapper.grid()
    T_m_g = SE2.from_array(T_r_s) @ grid.T_m_g
    return Mapped(
        grid=OccupancyGrid(cells=grid.cells, resolution_m=grid.resolution_m, T_m_g=T_m_g), poses=poses
    )


def _step_rad(bearings_rad: Array) -> float:
    return float(np.median(np.abs(np.diff(bearings_rad)))) if len(bearings_rad) > 1 else 0.0


def _extent_m(odometry: Array, resolution_m: float) -> float:
    """Side of a square around the first pose that holds the path."""
    reach_m = float(np.abs(odometry[:, :, :2] - odometry[0, 0, :2]).max())
    most_m = min(_MOST_EXTENT_M, MOST_CELLS * resolution_m)
    return min(2.0 * (_DRIFT * reach_m + _MARGIN_M), most_m)
