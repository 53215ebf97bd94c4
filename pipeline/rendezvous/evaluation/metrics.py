"""How well maps and poses agree."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from rendezvous.geometry.occupancy_grid import Mask, OccupancyGrid
from rendezvous.geometry.se2 import SE2, Array, wrap_angle


def ghost_cells(
    grid: OccupancyGrid,
    T_w_m: SE2,
    segments_w_m: Array,
    other_path_w_m: Array,
    *,
    clear_m: float = 0.20,
    near_path_m: float = 0.30,
) -> Mask:
    """(H, W) bool: the occupied cells that the other robot left behind.

    Args:
        grid: the map, in frame m.
        T_w_m: pose of the map in the plan.
        segments_w_m: (E, 4) x0, y0, x1, y1 [m] of every true face of wall and furniture that the lidar sees.
        other_path_w_m: (N, 2) [m] true positions of the other robot.
        clear_m: farther than this from every face, a cell is no wall drawn a little off.
        near_path_m: within this of the other robot's path, the robot is what was seen there.
    """
    row_col = np.argwhere(grid.occupied())
    centres_w_m = T_w_m @ grid.cell_centres(grid.occupied())
    ghosts = np.zeros_like(grid.occupied())
    if not len(centres_w_m) or not len(other_path_w_m):
        return ghosts
    distance_m, _ = cKDTree(other_path_w_m).query(centres_w_m, distance_upper_bound=near_path_m)
    on_path = np.isfinite(distance_m)
    off_walls = distance_to_segments(centres_w_m[on_path], segments_w_m) > clear_m
    rows, cols = row_col[on_path][off_walls].T
    ghosts[rows, cols] = True
    return ghosts


def distance_to_segments(points_m: Array, segments_m: Array) -> Array:
    """(N,) distance [m] of points (N, 2) to the nearest of segments (E, 4); inf without segments."""
    if not len(segments_m):
        return np.full(len(points_m), np.inf)
    starts_m, edges_m = segments_m[:, :2], segments_m[:, 2:] - segments_m[:, :2]
    offsets_m = points_m[:, None] - starts_m
    along = np.einsum("nek,ek->ne", offsets_m, edges_m) / np.einsum("ek,ek->e", edges_m, edges_m)
    nearest_m = np.clip(along, 0.0, 1.0)[..., None] * edges_m
    return np.linalg.norm(offsets_m - nearest_m, axis=2).min(axis=1)


@dataclass(frozen=True, slots=True, kw_only=True)
class PoseError:
    """How far an estimated pose is from the true one: distance [m] and absolute angle [rad]."""

    position_m: float
    heading_rad: float


def pose_error(T_a_b: SE2, T_a_b_true: SE2) -> PoseError:
    """The error of a pose; equal for the poses of b in a and for those of a in b only in heading."""
    return PoseError(
        position_m=float(np.hypot(T_a_b.x_m - T_a_b_true.x_m, T_a_b.y_m - T_a_b_true.y_m)),
        heading_rad=abs(wrap_angle(T_a_b.yaw_rad - T_a_b_true.yaw_rad)),
    )
