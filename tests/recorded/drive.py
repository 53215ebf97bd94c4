"""A robot driven about a room: true poses, exact scans, and the text of CARMEN's log of it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rendezvous.geometry.se2 import Array
from rendezvous.recorded.laser_log import LaserLog
from rendezvous.simulation.rays import cast_rays, ray_scene

# An L-shaped room with a pillar, so that no turn or shift of it looks like another.
_CORNERS = np.array([[0, 0], [9, 0], [9, 4], [5, 4], [5, 7], [0, 7], [0, 0]], float)
_PILLAR = np.array([[2.0, 3.0], [2.6, 3.0], [2.6, 3.8], [2.0, 3.8], [2.0, 3.0]])
SEGMENTS_M = np.concatenate([np.hstack([ring[:-1], ring[1:]]) for ring in (_CORNERS, _PILLAR)])
BEARINGS_RAD = np.deg2rad(np.arange(-90.0, 90.0, 1.0))


@dataclass(frozen=True)
class Drive:
    """Where the robot was, and what its lidar read."""

    poses_w: Array  # (N, 3)
    ranges_m: Array  # (N, B)
    t_s: Array  # (N,)


def driven(
    *, scans: int = 60, bearings_rad: Array = BEARINGS_RAD, lidar_xy_m: tuple[float, float] = (0.0, 0.0)
) -> Drive:
    """Along the long side of the room and back again on the other side of the pillar."""
    along = np.linspace(0.0, 1.0, scans)
    x_m = np.where(along < 0.5, 1.0 + 12.0 * along, 7.0 - 12.0 * (along - 0.5))
    y_m = 1.4 + 0.9 * np.sin(2.0 * np.pi * along)
    yaw_rad = np.interp(along, [0.0, 0.45, 0.55, 1.0], [0.1, 0.0, np.pi, np.pi])
    poses_w = np.column_stack([x_m, y_m, yaw_rad])
    scene = ray_scene(SEGMENTS_M, np.empty((0, 3)))
    ranges_m = []
    for x, y, yaw in poses_w:
        c, s = np.cos(yaw), np.sin(yaw)
        at = [x + c * lidar_xy_m[0] - s * lidar_xy_m[1], y + s * lidar_xy_m[0] + c * lidar_xy_m[1], yaw]
        lidar_w = np.tile(at, (len(bearings_rad), 1))
        ranges_m.append(cast_rays(scene, lidar_w, bearings_rad, max_range_m=80.0))
    return Drive(poses_w=poses_w, ranges_m=np.array(ranges_m), t_s=100.0 + 0.5 * np.arange(scans))


def laser_log(drive: Drive, **changes: object) -> LaserLog:
    """The drive as a log with perfect odometry and reference."""
    fields: dict[str, object] = {
        "source": "drive.log",
        "t_s": drive.t_s,
        "ranges_m": drive.ranges_m,
        "bearings_rad": BEARINGS_RAD,
        "lidar_xy_m": (0.0, 0.0),
        "range_max_m": 80.0,
        "odometry": drive.poses_w,
        "odometry_start": drive.poses_w,
        "reference": drive.poses_w,
    }
    return LaserLog(**(fields | changes))  # type: ignore[arg-type]


def carmen_text(drive: Drive, *, laser: Array | None = None, head: str = "") -> str:
    """The drive as FLASER lines; `laser` (N, 3) are the laser's poses where they differ from odometry."""
    laser = drive.poses_w if laser is None else laser
    lines = []
    for ranges_m, at, robot, t in zip(drive.ranges_m, laser, drive.poses_w, drive.t_s, strict=True):
        numbers = [*ranges_m, *at, *robot, t]
        lines.append(f"FLASER {len(ranges_m)} {' '.join(f'{v:.6f}' for v in numbers)} robot {t:.6f}\n")
    return f"# CARMEN\n{head}{''.join(lines)}"
