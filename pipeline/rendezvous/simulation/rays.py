"""Exact ray casting in the plane, against segments and circles.

The scene is bucketed into square cells; a ray walks the cells it crosses (Amanatides & Woo, 1987) and tests
only what they hold.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rendezvous.compiled import njit
from rendezvous.geometry.se2 import Array

CELL_M = 0.25


class RayScene(NamedTuple):
    """Segments and circles, bucketed into cells."""

    segments_m: Array  # (S, 4) x0, y0, x1, y1
    circles_m: Array  # (C, 3) x, y, radius
    origin_m: Array  # (2,) lower-left corner of cell (0, 0)
    starts: NDArray[np.int32]  # (rows * cols + 1,) int32 offsets into items
    items: NDArray[np.int32]  # int32; i < S is a segment, S + j a circle
    # rows, cols: number of cells.
    rows: int
    cols: int


def ray_scene(segments_m: Array, circles_m: Array) -> RayScene:
    """Bucket segments (S, 4) and circles (C, 3) [m] for casting."""
    segments_m = np.ascontiguousarray(segments_m, dtype=np.float64).reshape(-1, 4)
    circles_m = np.ascontiguousarray(circles_m, dtype=np.float64).reshape(-1, 3)
    starts_m, ends_m, centres_m = segments_m[:, :2], segments_m[:, 2:], circles_m[:, :2]
    low_m = np.concatenate([np.minimum(starts_m, ends_m), centres_m - circles_m[:, 2:]])
    high_m = np.concatenate([np.maximum(starts_m, ends_m), centres_m + circles_m[:, 2:]])
    origin_m = low_m.min(axis=0) - CELL_M
    cols, rows = (int(n) for n in np.ceil((high_m.max(axis=0) + CELL_M - origin_m) / CELL_M))
    starts, items = _bucket(segments_m, low_m, high_m, origin_m, rows, cols)
    return RayScene(segments_m, circles_m, origin_m, starts, items, rows, cols)


@njit
def _touches_cell(s: Array, x0: float, y0: float, x1: float, y1: float) -> bool:
    """Separating axes of segment and cell, with a micrometre of slack for rays along cell borders."""
    e = 1e-6
    if max(s[0], s[2]) < x0 - e or min(s[0], s[2]) > x1 + e:
        return False
    if max(s[1], s[3]) < y0 - e or min(s[1], s[3]) > y1 + e:
        return False
    nx, ny = s[1] - s[3], s[2] - s[0]
    c = nx * s[0] + ny * s[1]
    reach = 0.5 * (abs(nx) * (x1 - x0) + abs(ny) * (y1 - y0)) + e * (abs(nx) + abs(ny))
    return abs(nx * 0.5 * (x0 + x1) + ny * 0.5 * (y0 + y1) - c) <= reach


@njit
def _bucket(
    segments_m: Array, low_m: Array, high_m: Array, origin_m: Array, rows: int, cols: int
) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """CSR: offsets of the cells, and the items of one cell after the other, from their bounds (N, 2)."""
    cells, items = [], []
    for i in range(len(low_m)):
        c0, r0 = (
            int((low_m[i, 0] - origin_m[0]) / CELL_M - 1e-5),
            int((low_m[i, 1] - origin_m[1]) / CELL_M - 1e-5),
        )
        c1 = min(int((high_m[i, 0] - origin_m[0]) / CELL_M + 1e-5), cols - 1)
        r1 = min(int((high_m[i, 1] - origin_m[1]) / CELL_M + 1e-5), rows - 1)
        for row in range(max(r0, 0), r1 + 1):
            for col in range(max(c0, 0), c1 + 1):
                x0, y0 = origin_m[0] + col * CELL_M, origin_m[1] + row * CELL_M
                is_circle = i >= len(segments_m)
                if is_circle or _touches_cell(segments_m[i], x0, y0, x0 + CELL_M, y0 + CELL_M):
                    cells.append(row * cols + col)
                    items.append(i)
    cell = np.array(cells)
    order = np.argsort(cell, kind="mergesort")  # stable
    starts = np.searchsorted(cell[order], np.arange(rows * cols + 1))
    return starts.astype(np.int32), np.array(items)[order].astype(np.int32)


@njit(inline="always")
def _ray_segment(ox: float, oy: float, dx: float, dy: float, s: Array) -> float:
    """Distance along the ray to the segment, inf for a miss."""
    ex, ey = s[2] - s[0], s[3] - s[1]
    cross = dx * ey - dy * ex
    if cross == 0.0:
        return np.inf
    px, py = s[0] - ox, s[1] - oy
    t = (px * ey - py * ex) / cross
    u = (px * dy - py * dx) / cross
    return t if t >= 0.0 and -1e-12 <= u <= 1.0 + 1e-12 else np.inf


@njit(inline="always")
def _ray_circle(ox: float, oy: float, dx: float, dy: float, x: float, y: float, r: float) -> float:
    """Distance along the ray to the circle's near side, inf for a miss or an origin inside it."""
    px, py = x - ox, y - oy
    b = px * dx + py * dy
    disc = b * b - (px * px + py * py - r * r)
    if disc < 0.0:
        return np.inf
    t = b - math.sqrt(disc)
    return t if t >= 0.0 else np.inf


@njit
def _enter(gx: float, gy: float, dx: float, dy: float, cols: int, rows: int) -> float:
    """Distance [cells] along the ray to the grid of cells, inf if it passes by."""
    near, far = 0.0, np.inf
    for g, d, n in ((gx, dx, cols), (gy, dy, rows)):
        if d == 0.0:
            if not 0.0 <= g <= n:
                return np.inf
            continue
        a, b = -g / d, (n - g) / d
        near, far = max(near, min(a, b)), min(far, max(a, b))
    return near if near <= far else np.inf


@njit
def _cast_one(ox: float, oy: float, dx: float, dy: float, max_range_m: float, scene: RayScene) -> float:
    """Distance to the first item along the ray, inf if it is beyond `max_range_m`."""
    segments_m, circles_m, origin_m, starts, items, rows, cols = scene
    n_segments = segments_m.shape[0]
    gx, gy = (ox - origin_m[0]) / CELL_M, (oy - origin_m[1]) / CELL_M
    enter = 0.0
    if not (0.0 <= gx < cols and 0.0 <= gy < rows):
        enter = _enter(gx, gy, dx, dy, cols, rows)
        if enter == np.inf:
            return np.inf
    # From outside: start in the border cell through which the ray comes in.
    col = min(max(math.floor(gx + enter * dx), 0), cols - 1)
    row = min(max(math.floor(gy + enter * dy), 0), rows - 1)
    step_c = 1 if dx > 0.0 else -1
    step_r = 1 if dy > 0.0 else -1
    delta_c = CELL_M / abs(dx) if dx != 0.0 else np.inf
    delta_r = CELL_M / abs(dy) if dy != 0.0 else np.inf
    next_c = (col + (step_c > 0) - gx) * CELL_M / dx if dx != 0.0 else np.inf
    next_r = (row + (step_r > 0) - gy) * CELL_M / dy if dy != 0.0 else np.inf
    best = np.inf
    while 0 <= col < cols and 0 <= row < rows:
        cell = row * cols + col
        for k in range(starts[cell], starts[cell + 1]):
            i = items[k]
            if i < n_segments:
                t = _ray_segment(ox, oy, dx, dy, segments_m[i])
            else:
                c = circles_m[i - n_segments]
                t = _ray_circle(ox, oy, dx, dy, c[0], c[1], c[2])
            best = min(best, t)
        leave = min(next_c, next_r)
        if best <= leave or leave > max_range_m:
            break
        if next_c < next_r:
            col += step_c
            next_c += delta_c
        else:
            row += step_r
            next_r += delta_r
    return best if best <= max_range_m else np.inf


@njit
def _cast_sweep(
    poses_w: Array, bearings_rad: Array, others_m: Array, max_range_m: float, scene: RayScene
) -> Array:
    ranges_m = np.empty(bearings_rad.shape[0])
    for i in range(bearings_rad.shape[0]):
        heading = poses_w[i, 2] + bearings_rad[i]
        dx, dy = math.cos(heading), math.sin(heading)
        best = _cast_one(poses_w[i, 0], poses_w[i, 1], dx, dy, max_range_m, scene)
        if others_m.shape[0] > 0:
            t = _ray_circle(
                poses_w[i, 0], poses_w[i, 1], dx, dy, others_m[i, 0], others_m[i, 1], others_m[i, 2]
            )
            if t < best and t <= max_range_m:
                best = t
        ranges_m[i] = best
    return ranges_m


def cast_rays(
    scene: RayScene, T_w_l: Array, bearings_rad: Array, *, max_range_m: float, others_m: Array | None = None
) -> Array:
    """Range to the first surface along each beam: (B,) float64 [m], inf for no hit.

    Args:
        scene: all that stands still.
        T_w_l: (B, 3) the lidar's x, y, yaw in w as each beam is shot.
        bearings_rad: (B,) directions in l.
        max_range_m: beyond it a beam has no hit.
        others_m: (B, 3) x, y, radius of a moving circle (another robot) as each beam is shot.
    """
    others_m = np.empty((0, 3)) if others_m is None else others_m
    return _cast_sweep(T_w_l, bearings_rad, others_m, max_range_m, scene)
