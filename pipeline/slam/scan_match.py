"""Scan matching: point-to-line registration of a scan against a map of surface elements.

The map keeps, per cell, the mean and normal of the surface points seen there, apart for the two faces of a
wall: a point is matched only with a surface seen from its own side, or a 0.1 m wall would let a scan lock
on to its far face. Averaging over many scans makes the surface finer than the lidar's noise.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numba as nb
import numpy as np
from numpy.typing import NDArray

from pipeline.geometry.se2 import Array


@dataclass(frozen=True, slots=True, kw_only=True)
class MatchParameters:
    """Settings of the matcher.

    Attributes:
        cell_m: side of the cells that hold surface elements.
        beam_step: every how many beams are matched.
        normal_radius_m: points this near to each other on a scan give its normal.
        gate_m: a point farther than this from a surface is not matched with it.
        same_side: least cosine between the normals of a point and its surface.
        max_weight: scans after which an element is no longer moved, so that the map cannot creep.
        iterations: most Gauss-Newton steps.
        prior_*: sigma of the odometry between two scans: constant, and per metre or radian travelled.
    """

    cell_m: float = 0.10
    beam_step: int = 1
    normal_radius_m: float = 0.20
    gate_m: float = 0.15
    same_side: float = 0.7
    max_weight: float = 60.0
    iterations: int = 6
    prior_xy_m: float = 0.004
    prior_xy_per_m: float = 0.05
    prior_yaw_rad: float = 0.008
    prior_yaw_per_rad: float = 0.05


# Points look for their surface in the first steps only; by then the scan has nearly settled.
_ASSOCIATIONS = 3

# Columns of an element: mean x and y, unit normal, weight, and the length of the mean of its normals.
_X, _Y, _NX, _NY, _WEIGHT, _LENGTH = range(6)


@nb.njit(cache=True)
def scan_normals(points_m: Array, origins_m: Array, valid: NDArray[np.bool_], radius_m: float) -> Array:
    """(B, 2) unit normals towards the sensor; zero where the surface is not a line.

    Args:
        points_m: (B, 2) in beam order, closing the circle.
        origins_m: (B, 2) the sensor as each beam was shot.
        valid: (B,) which beams have a point.
        radius_m: neighbours farther than this do not count.
    """
    n = points_m.shape[0]
    normals = np.zeros((n, 2))
    for i in range(n):
        if not valid[i]:
            continue
        count, sx, sy, sxx, sxy, syy = 1, 0.0, 0.0, 0.0, 0.0, 0.0
        for direction in (-1, 1):
            for k in range(1, 13):
                j = (i + direction * k) % n
                if not valid[j]:
                    continue
                dx, dy = points_m[j, 0] - points_m[i, 0], points_m[j, 1] - points_m[i, 1]
                if dx * dx + dy * dy > radius_m * radius_m:
                    break
                count += 1
                sx += dx
                sy += dy
                sxx += dx * dx
                sxy += dx * dy
                syy += dy * dy
        if count < 4:
            continue
        cxx = sxx / count - (sx / count) ** 2
        cxy = sxy / count - (sx / count) * (sy / count)
        cyy = syy / count - (sy / count) ** 2
        half_trace = 0.5 * (cxx + cyy)
        root = math.sqrt((0.5 * (cxx - cyy)) ** 2 + cxy * cxy)
        if half_trace - root > 0.2 * (half_trace + root):
            continue
        along = 0.5 * math.atan2(2.0 * cxy, cxx - cyy)
        nx, ny = -math.sin(along), math.cos(along)
        to_x, to_y = origins_m[i, 0] - points_m[i, 0], origins_m[i, 1] - points_m[i, 1]
        sign = 1.0 if nx * to_x + ny * to_y > 0.0 else -1.0
        normals[i, 0], normals[i, 1] = sign * nx, sign * ny
    return normals


@nb.njit(cache=True)
def _insert(
    points_m: Array,
    normals: Array,
    sigma_m: Array,
    pose: Array,
    index: NDArray[np.int32],
    after: NDArray[np.int32],
    elements: Array,
    count: int,
    cell_m: float,
    same_side: float,
    max_weight: float,
) -> int:
    """Average the scan's points into their cells' elements; the number of elements after it."""
    c, s = math.cos(pose[2]), math.sin(pose[2])
    half = index.shape[0] // 2
    for i in range(points_m.shape[0]):
        if normals[i, 0] == 0.0 and normals[i, 1] == 0.0:
            continue
        x = pose[0] + c * points_m[i, 0] - s * points_m[i, 1]
        y = pose[1] + s * points_m[i, 0] + c * points_m[i, 1]
        nx = c * normals[i, 0] - s * normals[i, 1]
        ny = s * normals[i, 0] + c * normals[i, 1]
        row, col = math.floor(y / cell_m) + half, math.floor(x / cell_m) + half
        if not (0 <= row < index.shape[0] and 0 <= col < index.shape[1]):
            continue
        k = index[row, col]
        while k >= 0:
            e = elements[k]
            if e[_NX] * nx + e[_NY] * ny > same_side:
                break
            k = after[k]
        if k < 0:
            if count == elements.shape[0]:
                return -1
            k = count
            count += 1
            after[k] = index[row, col]
            index[row, col] = k
        e = elements[k]
        # A weight of 1 is one point at a sigma of 1 cm.
        w = (0.01 / sigma_m[i]) ** 2
        if e[_WEIGHT] < max_weight:
            share = w / (e[_WEIGHT] + w)
            e[_X] += share * (x - e[_X])
            e[_Y] += share * (y - e[_Y])
            mean_x = (1.0 - share) * e[_LENGTH] * e[_NX] + share * nx
            mean_y = (1.0 - share) * e[_LENGTH] * e[_NY] + share * ny
            e[_LENGTH] = math.sqrt(mean_x * mean_x + mean_y * mean_y)
            e[_NX], e[_NY] = mean_x / e[_LENGTH], mean_y / e[_LENGTH]
            e[_WEIGHT] += w
    return count


@nb.njit(cache=True, inline="always")
def _nearest(
    x: float,
    y: float,
    nx: float,
    ny: float,
    index: NDArray[np.int32],
    after: NDArray[np.int32],
    elements: Array,
    cell_m: float,
    gate_m: float,
    same_side: float,
) -> int:
    """The nearest element seen from the same side, -1 for none within the gate."""
    half = index.shape[0] // 2
    row, col = math.floor(y / cell_m) + half, math.floor(x / cell_m) + half
    best, best_d2 = -1, gate_m * gate_m
    for r in range(max(row - 1, 0), min(row + 2, index.shape[0])):
        for q in range(max(col - 1, 0), min(col + 2, index.shape[1])):
            k = index[r, q]
            while k >= 0:
                e = elements[k]
                dx, dy = e[_X] - x, e[_Y] - y
                d2 = dx * dx + dy * dy
                if d2 < best_d2 and e[_NX] * nx + e[_NY] * ny > same_side:
                    best, best_d2 = k, d2
                k = after[k]
    return best


@nb.njit(cache=True)
def _match(
    points_m: Array,
    normals: Array,
    sigma_m: Array,
    prior: Array,
    prior_info: Array,
    index: NDArray[np.int32],
    after: NDArray[np.int32],
    elements: Array,
    step: int,
    cell_m: float,
    gate_m: float,
    same_side: float,
    iterations: int,
) -> tuple[Array, int]:
    """Gauss-Newton on Cauchy-weighted point-to-line distances plus the prior; pose and matches used."""
    pose = prior.copy()
    cp, sp = math.cos(prior[2]), math.sin(prior[2])
    # The prior's information in map axes: its x and y are the robot's.
    pxx = cp * cp * prior_info[0] + sp * sp * prior_info[1]
    pxy = cp * sp * (prior_info[0] - prior_info[1])
    pyy = sp * sp * prior_info[0] + cp * cp * prior_info[1]
    H, g = np.zeros((3, 3)), np.zeros(3)
    n = (points_m.shape[0] + step - 1) // step
    matched = np.empty(n, np.int32)
    used = 0
    for iteration in range(iterations):
        c, s = math.cos(pose[2]), math.sin(pose[2])
        ex, ey, ea = pose[0] - prior[0], pose[1] - prior[1], pose[2] - prior[2]
        # Cauchy as well: wheels that spin against an obstacle must not outvote the walls.
        off = pxx * ex * ex + 2.0 * pxy * ex * ey + pyy * ey * ey + prior_info[2] * ea * ea
        trust = 1.0 / (1.0 + off / 9.0)
        h00, h01, h11, h22 = trust * pxx, trust * pxy, trust * pyy, trust * prior_info[2]
        h02 = h12 = 0.0
        g0, g1, g2 = h00 * ex + h01 * ey, h01 * ex + h11 * ey, h22 * ea
        used = 0
        for j in range(n):
            i = j * step
            if normals[i, 0] == 0.0 and normals[i, 1] == 0.0:
                continue
            if iteration >= _ASSOCIATIONS and matched[j] < 0:
                continue
            rx = c * points_m[i, 0] - s * points_m[i, 1]
            ry = s * points_m[i, 0] + c * points_m[i, 1]
            x, y = pose[0] + rx, pose[1] + ry
            if iteration < _ASSOCIATIONS:
                nx = c * normals[i, 0] - s * normals[i, 1]
                ny = s * normals[i, 0] + c * normals[i, 1]
                matched[j] = _nearest(x, y, nx, ny, index, after, elements, cell_m, gate_m, same_side)
                if matched[j] < 0:
                    continue
            e = elements[matched[j]]
            mx, my = e[_NX], e[_NY]
            r = mx * (x - e[_X]) + my * (y - e[_Y])
            var = sigma_m[i] ** 2 + 1e-4 / e[_WEIGHT] + 2.5e-5
            w = 1.0 / (var + r * r / 4.0)
            j2 = -mx * ry + my * rx
            h00 += w * mx * mx
            h01 += w * mx * my
            h11 += w * my * my
            h02 += w * mx * j2
            h12 += w * my * j2
            h22 += w * j2 * j2
            g0 += w * mx * r
            g1 += w * my * r
            g2 += w * j2 * r
            used += 1
        H[0, 0], H[0, 1], H[0, 2] = h00, h01, h02
        H[1, 0], H[1, 1], H[1, 2] = h01, h11, h12
        H[2, 0], H[2, 1], H[2, 2] = h02, h12, h22
        g[0], g[1], g[2] = g0, g1, g2
        delta = np.linalg.solve(H, g)
        pose -= delta
        if abs(delta[0]) + abs(delta[1]) < 5e-4 and abs(delta[2]) < 2e-4:
            break
    return pose, used


class SurfaceMap:
    """Surface elements of one map, and registration against them.

    Args:
        extent_m: side of the square that the map can hold, its origin in the middle.
        parameters: settings.
    """

    def __init__(self, *, extent_m: float, parameters: MatchParameters) -> None:
        cells = 2 * math.ceil(0.5 * extent_m / parameters.cell_m)
        self._p = parameters
        self._index = np.full((cells, cells), -1, np.int32)
        self._elements = np.zeros((4096, 6))
        self._after = np.full(4096, -1, np.int32)
        self._count = 0

    def __len__(self) -> int:
        return self._count

    def insert(self, points_m: Array, normals: Array, sigma_m: Array, pose: Array) -> None:
        """Average a scan into the map.

        Args:
            points_m: (B, 2) in the robot frame.
            normals: (B, 2) from `scan_normals`.
            sigma_m: (B,) standard deviation of each range.
            pose: (3,) of the robot in the map.
        """
        p = self._p
        if self._count + len(points_m) > len(self._elements):
            self._elements = np.concatenate([self._elements, np.zeros_like(self._elements)])
            self._after = np.concatenate([self._after, np.full_like(self._after, -1)])
        self._count = _insert(
            points_m, normals, sigma_m, pose, self._index, self._after, self._elements, self._count,
            p.cell_m, p.same_side, p.max_weight,
        )  # fmt: skip

    def match(
        self, points_m: Array, normals: Array, sigma_m: Array, prior: Array, *, travelled: Array
    ) -> tuple[Array, int]:
        """Register a scan.

        Args:
            points_m, normals, sigma_m: as for `insert`.
            prior: (3,) pose that odometry predicts.
            travelled: (3,) motion since the last scan in the robot frame; it sets the prior's sigma.

        Returns:
            (3,) pose and the number of points matched.
        """
        p = self._p
        distance_m = math.hypot(travelled[0], travelled[1])
        sigma_xy_m = p.prior_xy_m + p.prior_xy_per_m * distance_m
        sigma_yaw = p.prior_yaw_rad + p.prior_yaw_per_rad * abs(travelled[2])
        info = np.array([sigma_xy_m**-2, sigma_xy_m**-2, sigma_yaw**-2])
        return _match(
            points_m, normals, sigma_m, prior, info, self._index, self._after, self._elements,
            p.beam_step, p.cell_m, p.gate_m, p.same_side, p.iterations,
        )  # fmt: skip
