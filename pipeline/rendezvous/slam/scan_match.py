"""Scan matching: point-to-line registration of a scan against a map of surface elements."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rendezvous.compiled import njit
from rendezvous.errors import require_within
from rendezvous.geometry.se2 import Array
from rendezvous.slam.surface_map import NX, NY, WEIGHT, Surface, SurfaceMap, X, Y, nearest


@dataclass(frozen=True, slots=True, kw_only=True)
class MatchParameters:
    """How scans are matched."""

    cell_m: float = 0.10  # side of the cells that hold surface elements
    beam_step: int = 1  # only every n-th beam is matched
    normal_radius_m: float = 0.20  # a point's normal is fitted to the neighbours within this distance
    gate_m: float = 0.15  # a point is matched only with a surface within this distance
    same_side: float = 0.7  # least cosine between the normals of a point and its surface
    max_weight: float = 60.0  # scans after which an element stops moving, so that the map cannot creep
    iterations: int = 6  # most Gauss-Newton steps
    # Sigma of the odometry between two scans: constant, and per metre or radian travelled.
    prior_xy_m: float = 0.004
    prior_xy_per_m: float = 0.05
    prior_yaw_rad: float = 0.008
    prior_yaw_per_rad: float = 0.05

    def __post_init__(self) -> None:
        require_within(
            self, cell_m=(0.02, 1), beam_step=(1, 90), normal_radius_m=(0.02, 2), gate_m=(0.01, 1),
            same_side=(-1, 0.999), max_weight=(0.1, 1e9), iterations=(1, 100), prior_xy_m=(1e-6, 10),
            prior_xy_per_m=(0, 10), prior_yaw_rad=(1e-6, 10), prior_yaw_per_rad=(0, 10),
        )  # fmt: skip

    def prior_sigmas(self, travelled: Array) -> tuple[float, float]:
        """Sigma [m] and [rad] of odometry's motion (3,) from one scan to the next."""
        return (
            self.prior_xy_m + self.prior_xy_per_m * math.hypot(travelled[0], travelled[1]),
            self.prior_yaw_rad + self.prior_yaw_per_rad * abs(travelled[2]),
        )


Matches = NDArray[np.int32]

# Points are matched with surfaces in the first steps only; by then the scan has nearly settled.
_ASSOCIATIONS = 3


@njit
def scan_normals(points_m: Array, origins_m: Array, valid: NDArray[np.bool_], radius_m: float) -> Array:
    """(B, 2) unit normals towards the sensor; zero where the points do not form a line.

    Points (B, 2) are in beam order and close the circle, origins the sensor as each beam was shot; only
    neighbours within the radius count.
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


def match_scan(
    seen: SurfaceMap,
    points_m: Array,
    normals: Array,
    sigma_m: Array,
    prior: Array,
    *,
    travelled: Array,
    parameters: MatchParameters,
) -> tuple[Array, int]:
    """Register a scan: Gauss-Newton on Cauchy-weighted point-to-line distances plus the prior.

    The prior (3,) is the pose that odometry predicts; `travelled` (3,), the motion since the last scan in the
    robot frame, sets its sigma. Points are as for `SurfaceMap.insert`.

    Returns:
        (3,) pose and the number of points matched.
    """
    p = parameters
    sigma_xy_m, sigma_yaw_rad = p.prior_sigmas(travelled)
    step = p.beam_step
    pose, _, matched = registered(
        seen.surface, points_m[::step], normals[::step], sigma_m[::step], prior,
        sigma_xy_m=sigma_xy_m, sigma_yaw_rad=sigma_yaw_rad, gate_m=p.gate_m, iterations=p.iterations,
    )  # fmt: skip
    return pose, matched


def registered(
    surface: Surface,
    points_m: Array,
    normals: Array,
    sigma_m: Array,
    prior: Array,
    *,
    sigma_xy_m: float,
    sigma_yaw_rad: float,
    gate_m: float,
    iterations: int,
) -> tuple[Array, Array, int]:
    """Register points with normals to a surface; see `match_scan`.

    Returns:
        (3,) pose, (3, 3) its information with that of the prior, as if points erred independently, and the
        number of points matched.
    """
    return _match(
        points_m, normals, sigma_m, prior, sigma_xy_m**-2, sigma_yaw_rad**-2, surface, gate_m, iterations
    )


@njit
def _match(
    points_m: Array,
    normals: Array,
    sigma_m: Array,
    prior: Array,
    info_xy: float,
    info_yaw: float,
    surface: Surface,
    gate_m: float,
    iterations: int,
) -> tuple[Array, Array, int]:
    pose = prior.copy()
    matched = np.empty(points_m.shape[0], np.int32)
    H, g = np.zeros((3, 3)), np.zeros(3)
    for iteration in range(iterations):
        if iteration < _ASSOCIATIONS:
            _associate(points_m, normals, pose, surface, gate_m, matched)
        _prior_terms(pose, prior, info_xy, info_yaw, H, g)
        _add_point_terms(points_m, sigma_m, matched, surface.elements, pose, H, g)
        delta = np.linalg.solve(H, g)
        pose -= delta
        if abs(delta[0]) + abs(delta[1]) < 5e-4 and abs(delta[2]) < 2e-4:
            break
    return pose, H, int((matched >= 0).sum())


@njit
def _associate(
    points_m: Array, normals: Array, pose: Array, surface: Surface, gate_m: float, matched: Matches
) -> None:
    """Write each point's element into `matched`, -1 for none."""
    c, s = math.cos(pose[2]), math.sin(pose[2])
    for i in range(points_m.shape[0]):
        matched[i] = -1
        if normals[i, 0] == 0.0 and normals[i, 1] == 0.0:
            continue
        x = pose[0] + (c * points_m[i, 0] - s * points_m[i, 1])
        y = pose[1] + (s * points_m[i, 0] + c * points_m[i, 1])
        nx = c * normals[i, 0] - s * normals[i, 1]
        ny = s * normals[i, 0] + c * normals[i, 1]
        matched[i] = nearest(x, y, nx, ny, surface, gate_m)


@njit
def _prior_terms(pose: Array, prior: Array, info_xy: float, info_yaw: float, H: Array, g: Array) -> None:
    """Start the normal equations with the prior.

    It is Cauchy-weighted too: wheels that spin against an obstacle must not outvote the walls.
    """
    ex, ey, ea = pose[0] - prior[0], pose[1] - prior[1], pose[2] - prior[2]
    off = info_xy * (ex * ex + ey * ey) + info_yaw * ea * ea
    trust = 1.0 / (1.0 + off / 9.0)
    H[:] = 0.0
    H[0, 0] = H[1, 1] = trust * info_xy
    H[2, 2] = trust * info_yaw
    g[0], g[1], g[2] = trust * info_xy * ex, trust * info_xy * ey, trust * info_yaw * ea


@njit
def _add_point_terms(
    points_m: Array, sigma_m: Array, matched: Matches, elements: Array, pose: Array, H: Array, g: Array
) -> None:
    """Add the matched points' distances from their lines to the normal equations."""
    c, s = math.cos(pose[2]), math.sin(pose[2])
    h00, h01, h11, h02, h12, h22, g0, g1, g2 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for i in range(points_m.shape[0]):
        if matched[i] < 0:
            continue
        e = elements[matched[i]]
        rx = c * points_m[i, 0] - s * points_m[i, 1]
        ry = s * points_m[i, 0] + c * points_m[i, 1]
        mx, my = e[NX], e[NY]
        r = mx * (pose[0] + rx - e[X]) + my * (pose[1] + ry - e[Y])
        # Variance of the point, of the element's mean, and of the surface about its element (5 mm).
        var = sigma_m[i] ** 2 + 1e-4 / e[WEIGHT] + 2.5e-5
        w = 1.0 / (var + r * r / 4.0)
        turn = -mx * ry + my * rx
        h00 += w * mx * mx
        h01 += w * mx * my
        h11 += w * my * my
        h02 += w * mx * turn
        h12 += w * my * turn
        h22 += w * turn * turn
        g0 += w * mx * r
        g1 += w * my * r
        g2 += w * turn * r
    H[0, 0] += h00
    H[0, 1] += h01
    H[1, 0] += h01
    H[1, 1] += h11
    H[0, 2] += h02
    H[2, 0] += h02
    H[1, 2] += h12
    H[2, 1] += h12
    H[2, 2] += h22
    g[0] += g0
    g[1] += g1
    g[2] += g2
