"""Rendezvous drawn instead of driven: two cuts of one furnished building, with exact poses.

And images of the robot painted instead of rendered, with exact labels."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np

from rendezvous.evaluation.metrics import pose_error
from rendezvous.geometry.camera import PinholeCamera, camera_pose, se3_from_se2
from rendezvous.geometry.cuboid import project_cuboid
from rendezvous.geometry.occupancy_grid import FREE, OCCUPIED, UNKNOWN, OccupancyGrid, overlap
from rendezvous.geometry.se2 import SE2, Array
from rendezvous.geometry.wall_agreement import wall_agreement

RESOLUTION_M = 0.05
FINE_M = 0.02
CAMERA = PinholeCamera(fx_px=616.0, fy_px=616.0, cx_px=319.5, cy_px=239.5, width_px=640, height_px=480)


@dataclass(frozen=True)
class Building:
    """The signed distance [m] to the walls and furniture of a building, negative inside them."""

    signed_distance_m: np.ndarray
    segments_m: Array

    def distance_m(self, p_w: Array) -> Array:
        col, row = np.moveaxis(np.floor(p_w / FINE_M).astype(int), -1, 0)
        height, width = self.signed_distance_m.shape
        inside = (row >= 0) & (row < height) & (col >= 0) & (col < width)
        found = self.signed_distance_m[row.clip(0, height - 1), col.clip(0, width - 1)]
        return np.where(inside, found, -1.0)


def building(rng: np.random.Generator, *, width_m: float = 14.0, depth_m: float = 9.0) -> Building:
    """Six rooms around a corridor, a door each, some boxes as furniture (uniform positions and sizes)."""
    boxes = [(0.0, 0.0, width_m, 0.2), (0.0, depth_m - 0.2, width_m, depth_m)]
    boxes += [(0.0, 0.0, 0.2, depth_m), (width_m - 0.2, 0.0, width_m, depth_m)]
    third, low, high = width_m / 3, depth_m * 0.42, depth_m * 0.58
    for i in range(3):
        for y in (low, high):
            door = i * third + rng.uniform(0.8, third - 1.8)
            boxes += [
                (i * third, y - 0.05, door, y + 0.05),
                (door + 0.9, y - 0.05, (i + 1) * third, y + 0.05),
            ]
    for x in (third, 2 * third):
        boxes += [(x - 0.05, 0.0, x + 0.05, low), (x - 0.05, high, x + 0.05, depth_m)]
    for _ in range(24):
        x, y = rng.uniform(0.3, width_m - 0.8), rng.uniform(0.3, depth_m - 0.8)
        if not low - 0.9 < y < high + 0.3:
            boxes.append((x, y, x + rng.uniform(0.05, 0.7), y + rng.uniform(0.05, 0.5)))
    solid = np.zeros((round(depth_m / FINE_M), round(width_m / FINE_M)), np.uint8)
    for x0, y0, x1, y1 in boxes:
        solid[round(y0 / FINE_M) : round(y1 / FINE_M), round(x0 / FINE_M) : round(x1 / FINE_M)] = 1
    outside = cv2.distanceTransform(1 - solid, cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    inside = cv2.distanceTransform(solid, cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    faces = [f for x0, y0, x1, y1 in boxes for f in _faces(x0, y0, x1, y1)]
    return Building(signed_distance_m=FINE_M * (outside - inside), segments_m=np.array(faces))


def _faces(x0: float, y0: float, x1: float, y1: float) -> list[tuple[float, float, float, float]]:
    return [(x0, y0, x1, y0), (x1, y0, x1, y1), (x1, y1, x0, y1), (x0, y1, x0, y0)]


def cut(house: Building, T_w_m: SE2, path_w_m: Array, *, reach_m: float = 3.5) -> OccupancyGrid:
    """The map, in frame m, of what lies within reach of a path: faces occupied, solid cores unknown."""
    half = 260
    everything = OccupancyGrid(
        cells=np.full((2 * half, 2 * half), UNKNOWN, np.uint8),
        resolution_m=RESOLUTION_M,
        T_m_g=SE2(-half * RESOLUTION_M, -half * RESOLUTION_M, 0.0),
    )
    centres_w = T_w_m @ everything.cell_centres(np.ones_like(everything.cells, dtype=bool))
    gap_m = np.linalg.norm(centres_w[:, None] - path_w_m[None, ::4], axis=2).min(axis=1)
    distance_m = house.distance_m(centres_w)
    values = np.where(distance_m > 0.0, FREE, np.where(distance_m > -RESOLUTION_M, OCCUPIED, UNKNOWN))
    cells = np.where(gap_m < reach_m, values, UNKNOWN).astype(np.uint8).reshape(everything.cells.shape)
    return OccupancyGrid(cells=cells, resolution_m=RESOLUTION_M, T_m_g=everything.T_m_g).cropped()


def _path(start: SE2, end: SE2, steps: int = 40) -> Array:
    """(N, 4) t, x, y, yaw from start to end along an S; both in w."""
    s = np.linspace(0.0, 1.0, steps)
    smooth = s * s * (3 - 2 * s)
    x = start.x_m + (end.x_m - start.x_m) * s
    y = start.y_m + (end.y_m - start.y_m) * smooth
    yaw = start.yaw_rad + (end.yaw_rad - start.yaw_rad) * s
    return np.stack([40.0 * s, x, y, yaw], axis=1)


def _in_map(path_w: Array, T_m_w: SE2) -> Array:
    out = path_w.copy()
    out[:, 1:3] = T_m_w @ path_w[:, 1:3]
    out[:, 3] += T_m_w.yaw_rad
    return out


def synthetic_row(rng: np.random.Generator, *, plan: int = 0, event: int = 0) -> dict[str, Any]:
    """One valid row of `EXPLORE`; starts, drift (uniform within 3 cm, 0.5°) and furniture are drawn."""
    house = building(np.random.default_rng(plan))
    T_w_m = (
        SE2(rng.uniform(1.0, 4.0), rng.uniform(1.0, 3.0), rng.uniform(-3.1, 3.1)),
        SE2(rng.uniform(10.0, 13.0), rng.uniform(6.0, 8.0), rng.uniform(-3.1, 3.1)),
    )
    meeting_x_m = rng.uniform(5.0, 8.0)
    T_w_r = (SE2(meeting_x_m, 4.5, 0.1), SE2(meeting_x_m + rng.uniform(0.8, 2.0), 4.6, 3.0))
    drift = [SE2(*rng.uniform(-0.03, 0.03, 2), rng.uniform(-0.009, 0.009)) for _ in T_w_m]
    T_m_r_true = [(T_w_m[i].inverse() @ T_w_r[i]).wrapped() for i in (0, 1)]
    T_m_r = [(drift[i] @ T_m_r_true[i]).wrapped() for i in (0, 1)]
    paths_w = [_path(T_w_m[i], T_w_r[i]) for i in (0, 1)]
    grids = [cut(house, T_w_m[i] @ drift[i].inverse(), paths_w[i][:, 1:3]) for i in (0, 1)]
    T_r0_r1_true = (T_w_r[0].inverse() @ T_w_r[1]).wrapped()
    T_m0_m1 = (T_w_m[0].inverse() @ T_w_m[1]).wrapped()
    T_m0_m1_local = (T_m_r[0] @ T_r0_r1_true @ T_m_r[1].inverse()).wrapped()
    row: dict[str, Any] = {
        "pair_id": f"plan-{plan:03d}-{event}-0",
        "event_id": f"plan-{plan:03d}-{event}",
        "episode_id": f"plan-{plan:03d}",
        "observer": 0,
        "plan_id": f"plan-{plan:03d}",
        "plan_digest": hashlib.sha256(str(plan).encode()).hexdigest(),
        "seed": 0,
        "t_s": 40.0,
        "drive": "wheels",
        "furniture_density": 0.5,
        "resolution_m": RESOLUTION_M,
        "T_r0_r1_true": T_r0_r1_true,
        "T_m0_m1": T_m0_m1,
        "T_m0_m1_local": T_m0_m1_local,
        "overlap": overlap(*grids, T_m0_m1_local),
        "wall_agreement_local": wall_agreement(*grids, T_m0_m1_local).share,
        "wall_agreement": wall_agreement(*grids, T_m0_m1).share,
        "range_m": float(np.hypot(T_r0_r1_true.x_m, T_r0_r1_true.y_m)),
        "bearing_rad": float(np.arctan2(T_r0_r1_true.y_m, T_r0_r1_true.x_m)),
        "visible_fraction": 0.9,
        "robot": "scout",
        "cuboid_size_m": np.array([0.3, 0.2, 0.1]),
        "image_width_px": CAMERA.width_px,
        "image_height_px": CAMERA.height_px,
        "K": CAMERA.K(),
        "T_r0_c": camera_pose(np.array([0.03, 0.0, 0.19]), np.zeros(3)),
        "T_r1_o": np.eye(4),
        "furniture": [],
    }
    for i in (0, 1):
        odometry = SE2(*rng.uniform(-0.3, 0.3, 2), rng.uniform(-0.1, 0.1)) @ T_m_r_true[i]
        slam_error, odometry_error = (pose_error(T, T_m_r_true[i]) for T in (T_m_r[i], odometry))
        true_path = _in_map(paths_w[i], T_w_m[i].inverse())
        row |= {
            f"map_{i}": grids[i].png(),
            f"origin_{i}": grids[i].T_m_g,
            f"T_m{i}_r{i}": T_m_r[i],
            f"T_m{i}_r{i}_true": T_m_r_true[i],
            f"T_m{i}_r{i}_odometry": odometry,
            f"T_w_m{i}": T_w_m[i],
            f"slam_position_error_{i}_m": slam_error.position_m,
            f"slam_heading_error_{i}_rad": slam_error.heading_rad,
            f"odometry_position_error_{i}_m": odometry_error.position_m,
            f"odometry_heading_error_{i}_rad": odometry_error.heading_rad,
            f"trajectory_{i}": _in_map(true_path, drift[i]),
            f"trajectory_{i}_true": true_path,
            f"occupied_cells_{i}": int(grids[i].occupied().sum()),
            f"ghost_cells_{i}": 0,
        }
    return row


def _painted(rng: np.random.Generator, T_c_o: Array | None, size_m: Array) -> dict[str, Any]:
    """An image of the cuboid's outline before a wall, both of uniform colours, and its label."""
    pixels = np.full((CAMERA.height_px, CAMERA.width_px, 3), rng.integers(0, 256, 3), np.uint8)
    silhouette, box_px, points_px = np.zeros(pixels.shape[:2], np.uint8), None, None
    if T_c_o is not None:
        points_px = project_cuboid(T_c_o, tuple(size_m), CAMERA)
        cv2.fillConvexPoly(silhouette, cv2.convexHull(points_px.round().astype(np.int32)), 1)
        rows, cols = np.nonzero(silhouette)
        box_px = np.array([cols.min() - 0.5, rows.min() - 0.5, cols.max() + 0.5, rows.max() + 0.5])
        pixels[silhouette > 0] = rng.integers(0, 256, 3)
    seen_px = int(silhouette.sum())
    whole_px = round(seen_px / rng.uniform(0.3, 1.0))
    return {
        "image": cv2.imencode(".jpg", pixels)[1].tobytes(),
        "T_c_o": T_c_o,
        "projected_cuboid_px": points_px,
        "visibility": seen_px / whole_px if seen_px else 0.0,
        "visible_px": seen_px,
        "silhouette_px": whole_px,
        "box_px": box_px,
        "drawn": "{}",
    }


def synthetic_view(sighting: dict[str, Any]) -> dict[str, Any]:
    """The row of `VIEWS` of a sighting: what its camera sees, in colours that are its own."""
    rng = np.random.default_rng(list(sighting["pair_id"].encode()))
    T_r0_r1 = se3_from_se2(sighting["T_r0_r1_true"])
    T_c_o = np.linalg.inv(sighting["T_r0_c"]) @ T_r0_r1 @ sighting["T_r1_o"]
    ids = {name: sighting[name] for name in ("pair_id", "plan_id")}
    return ids | _painted(rng, T_c_o, sighting["cuboid_size_m"])


def synthetic_pose(*, plan: int, number: int) -> dict[str, Any]:
    """A row of `POSES`: the robot straight ahead at 0.5 to 3 m (uniform); every fifth image is without it."""
    rng = np.random.default_rng([plan, number])
    T_r0_c = camera_pose(np.array([0.03, 0.0, 0.19]), np.zeros(3))
    T_r0_o = se3_from_se2(SE2(rng.uniform(0.5, 3.0), 0.0, rng.uniform(-3.1, 3.1)))
    plausible, size_m = number % 2 == 0, np.array([0.3, 0.2, 0.1])
    return {
        "pose_id": f"plan-{plan:03d}-p{number:04d}",
        "plan_id": f"plan-{plan:03d}",
        "plan_digest": hashlib.sha256(str(plan).encode()).hexdigest(),
        "seed": 0,
        "mode": "plausible" if plausible else "free",
        "image_width_px": CAMERA.width_px,
        "image_height_px": CAMERA.height_px,
        "K": CAMERA.K(),
        "T_r0_c": T_r0_c if plausible else None,
        "T_r0_c_true": T_r0_c if plausible else None,
        "robot": "scout",
        "cuboid_size_m": size_m,
        "T_r1_o": np.eye(4),
        **_painted(rng, None if number % 5 == 4 else np.linalg.inv(T_r0_c) @ T_r0_o, size_m),
    }
