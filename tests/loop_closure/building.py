"""A robot driven around a ring of corridors, once and a quarter."""

from __future__ import annotations

import numpy as np

from rendezvous.geometry.se2 import Array
from rendezvous.recorded.laser_log import LaserLog
from rendezvous.simulation.rays import cast_rays, ray_scene
from rendezvous.slam.slam import compose
from tests.recorded.drive import BEARINGS_RAD

OUTER_M, INNER_M = (18.0, 14.0), (2.4, 2.4, 15.6, 11.6)


def _box(x0: float, y0: float, x1: float, y1: float) -> Array:
    ring = np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1], [x0, y0]])
    return np.hstack([ring[:-1], ring[1:]])


def walls_m() -> Array:
    """(S, 4) segments; cupboards of many sizes stand along the walls, so that no two places look alike."""
    rng = np.random.default_rng(7)
    boxes = [_box(0.0, 0.0, *OUTER_M), _box(*INNER_M)]
    for along in (1.5, 4.0, 6.0, 9.0, 11.5, 14.0, 16.0):
        for y in (0.0, OUTER_M[1]):
            width_m, depth_m = rng.uniform(0.3, 1.2), rng.uniform(0.15, 0.6)
            boxes.append(_box(along, y, along + width_m, y + (depth_m if y == 0.0 else -depth_m)))
    for along in (3.0, 5.0, 7.5, 10.0):
        for x in (0.0, OUTER_M[0]):
            width_m, depth_m = rng.uniform(0.3, 1.2), rng.uniform(0.15, 0.6)
            boxes.append(_box(x, along, x + (depth_m if x == 0.0 else -depth_m), along + width_m))
    return np.concatenate(boxes)


def driven_around(*, lidar_xy_m: tuple[float, float] = (0.0, 0.0)) -> LaserLog:
    """Scans each 0.4 m along the middle of the corridors, sigma 1 cm, with the truth as reference."""
    corners = np.array([[1.2, 1.2], [16.8, 1.2], [16.8, 12.8], [1.2, 12.8], [1.2, 1.2], [16.8, 1.2]])
    ends_m = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(corners, axis=0).T))])
    at_m = np.arange(2.0, ends_m[-1] - 2.0, 0.4)
    xy = np.column_stack([np.interp(at_m, ends_m, corners[:, k]) for k in (0, 1)])
    # Corners are taken within a metre.
    yaw = sum(0.5 * np.pi * np.clip((at_m - corner_m) / 1.0 + 0.5, 0.0, 1.0) for corner_m in ends_m[1:-1])
    poses = np.column_stack([xy, yaw])
    scene, rng = ray_scene(walls_m(), np.empty((0, 3))), np.random.default_rng(0)
    lidar = [compose(pose, np.array([*lidar_xy_m, 0.0])) for pose in poses]
    ranges_m = np.array(
        [cast_rays(scene, np.tile(p, (len(BEARINGS_RAD), 1)), BEARINGS_RAD, max_range_m=12.0) for p in lidar]
    )
    ranges_m += 0.01 * rng.standard_normal(ranges_m.shape)
    return LaserLog(
        source="ring.log",
        t_s=100.0 + np.arange(len(poses)),
        ranges_m=ranges_m,
        bearings_rad=BEARINGS_RAD,
        lidar_xy_m=lidar_xy_m,
        range_max_m=12.0,
        odometry=None,
        odometry_start=None,
        reference=poses,
    )
