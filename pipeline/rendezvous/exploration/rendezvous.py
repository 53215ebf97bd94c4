"""When one robot sees the other in its camera."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rendezvous.compiled import njit
from rendezvous.floorplan.walls import SightObstacles
from rendezvous.geometry.camera import se3_from_se2
from rendezvous.geometry.se2 import SE2, Array
from rendezvous.simulation.robot import Cuboid, RobotSpec

SAMPLES_PER_SIDE = 3


@dataclass(frozen=True, slots=True, kw_only=True)
class Sighting:
    """One robot seen by another one's camera."""

    range_m: float  # from the camera to the centre of the cuboid
    bearing_rad: float  # from the observer's heading to that centre, left positive
    visible_fraction: float  # share of the cuboid's sample points in the image with nothing before them


def cuboid_samples(cuboid: Cuboid) -> Array:
    """(26, 3) [m] in r: corners, edge middles and face centres of the cuboid."""
    side = np.linspace(-0.5, 0.5, SAMPLES_PER_SIDE)
    grid = np.stack(np.meshgrid(side, side, side, indexing="ij"), axis=-1).reshape(-1, 3)
    surface = grid[np.abs(grid).max(axis=1) == 0.5]
    return surface * np.array(cuboid.size_m) + np.array(cuboid.centre_m)


def sight(
    observer: RobotSpec,
    seen: RobotSpec,
    T_w_r0: SE2,
    T_w_r1: SE2,
    obstacles: SightObstacles,
    *,
    min_range_m: float,
    max_range_m: float,
) -> Sighting | None:
    """The observer's sighting of the other robot, None if it is out of range or view."""
    T_r0_r1 = T_w_r0.inverse() @ T_w_r1
    if math.hypot(T_r0_r1.x_m, T_r0_r1.y_m) > max_range_m + 1.0:
        return None
    if abs(math.atan2(T_r0_r1.y_m, T_r0_r1.x_m)) > _widest_bearing(observer, seen, T_r0_r1):
        return None
    T_w_c = se3_from_se2(T_w_r0) @ observer.camera.T_r_c()
    p_r1 = np.concatenate([[seen.cuboid.centre_m], cuboid_samples(seen.cuboid)])
    p_w = p_r1 @ se3_from_se2(T_w_r1)[:3, :3].T + se3_from_se2(T_w_r1)[:3, 3]
    p_c = (p_w - T_w_c[:3, 3]) @ T_w_c[:3, :3]
    range_m = float(np.linalg.norm(p_c[0]))
    if not min_range_m <= range_m <= max_range_m:
        return None
    camera = observer.camera.intrinsics()
    in_image = camera.in_image(camera.project(p_c[1:]))
    if not in_image.any():
        return None
    blocked = _blocked(T_w_c[:3, 3], p_w[1:], obstacles)
    centre_r0 = T_r0_r1 @ np.array(seen.cuboid.centre_m[:2])
    return Sighting(
        range_m=range_m,
        bearing_rad=math.atan2(centre_r0[1], centre_r0[0]),
        visible_fraction=float((in_image & ~blocked).mean()),
    )


def _widest_bearing(observer: RobotSpec, seen: RobotSpec, T_r0_r1: SE2) -> float:
    """Bearing of r1 [rad] beyond which no part of the other robot is in view."""
    distance_m = math.hypot(T_r0_r1.x_m, T_r0_r1.y_m)
    camera, cuboid = observer.camera, seen.cuboid
    # From r0 to the camera, and from r1 to the cuboid's farthest corner.
    reach_m = math.hypot(*camera.xyz_m[:2]) + math.hypot(*cuboid.centre_m[:2])
    reach_m += 0.5 * math.hypot(*cuboid.size_m[:2])
    half_view = math.atan(max(camera.cx_px, camera.width_px - camera.cx_px) / camera.fx_px)
    mount = math.hypot(camera.rpy_rad[0], camera.rpy_rad[1]) + abs(camera.rpy_rad[2])
    return half_view + mount + (math.asin(reach_m / distance_m) if distance_m > reach_m else math.pi)


@njit
def _blocked(eye: Array, points: Array, obstacles: SightObstacles) -> NDArray[np.bool_]:
    """(N,) bool: does a face or cylinder cross the line from the eye (3,) to each of the points (N, 3)?"""
    segments_m, bottoms_m, tops_m, circles_m = obstacles
    blocked = np.zeros(points.shape[0], np.bool_)
    for i in range(points.shape[0]):
        dx, dy, dz = points[i, 0] - eye[0], points[i, 1] - eye[1], points[i, 2] - eye[2]
        for k in range(segments_m.shape[0]):
            s = segments_m[k]
            ex, ey = s[2] - s[0], s[3] - s[1]
            cross = dx * ey - dy * ex
            if cross == 0.0:
                continue
            px, py = s[0] - eye[0], s[1] - eye[1]
            t = (px * ey - py * ex) / cross
            u = (px * dy - py * dx) / cross
            if 0.0 < t < 1.0 and 0.0 <= u <= 1.0 and bottoms_m[k] <= eye[2] + t * dz <= tops_m[k]:
                blocked[i] = True
                break
        if blocked[i]:
            continue
        length2 = dx * dx + dy * dy
        for k in range(circles_m.shape[0]):
            c = circles_m[k]
            t = min(max(((c[0] - eye[0]) * dx + (c[1] - eye[1]) * dy) / length2, 0.0), 1.0)
            gap2 = (eye[0] + t * dx - c[0]) ** 2 + (eye[1] + t * dy - c[1]) ** 2
            if gap2 < c[2] * c[2] and c[3] <= eye[2] + t * dz <= c[4]:
                blocked[i] = True
                break
    return blocked
