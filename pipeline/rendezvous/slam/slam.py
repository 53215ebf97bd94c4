"""SLAM of one robot from wheel encoders and lidar sweeps alone; no ground truth comes in."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rendezvous.compiled import njit
from rendezvous.errors import ConfigError, require_within
from rendezvous.geometry.se2 import Array
from rendezvous.slam.mapping import MappingParameters, OccupancyMapper
from rendezvous.slam.scan_match import MatchParameters, match_scan, scan_normals
from rendezvous.slam.surface_map import SurfaceMap

MOST_CELLS = 8000  # cells per side of the largest map
_BEAMS_ABOUT = 1.75  # beams within a normal's radius on either side: with the point's own at least four
_WIDEST_NORMAL_M = 0.8
_LEAST_SIGMA_M = 1e-3  # a surface seen by an ideal lidar still has a weight


@dataclass(frozen=True, slots=True, kw_only=True)
class SlamParameters:
    """Parameters of the SLAM."""

    extent_m: float = 80.0  # side of the square map
    # keyframe_m, keyframe_rad: motion after which a scan is averaged into the surface map.
    keyframe_m: float = 0.15
    keyframe_rad: float = 0.15
    match: MatchParameters = field(default_factory=MatchParameters)
    mapping: MappingParameters = field(default_factory=MappingParameters)

    def __post_init__(self) -> None:
        require_within(self, extent_m=(4, 400), keyframe_m=(0, 10), keyframe_rad=(0, 7))
        cells = self.extent_m / self.mapping.resolution_m
        if cells > MOST_CELLS:
            raise ConfigError(
                f"SlamParameters: extent_m {self.extent_m} at mapping.resolution_m "
                f"{self.mapping.resolution_m} makes {cells:.0f} cells a side; at most {MOST_CELLS}"
            )

    def with_normals(self, step_rad: float, *, to_m: float) -> SlamParameters:
        """The parameters under which also walls at `to_m`, met by beams this far apart, have normals."""
        radius_m = min(_BEAMS_ABOUT * step_rad * to_m, _WIDEST_NORMAL_M)
        radius_m = max(self.match.normal_radius_m, radius_m)
        return replace(self, match=replace(self.match, normal_radius_m=radius_m))


@dataclass(frozen=True, slots=True, kw_only=True)
class Sweep:
    """One turn of the lidar."""

    ranges_m: Array  # (B,) inf for no echo, NaN for no measurement
    odometry: Array  # (K, 3) odometry poses evenly spaced over the sweep, first at its start, last at its end


def last_part(knots: Array, ticks: float) -> Array:
    """(L, 3) poses evenly spaced over the last ticks of (K, 3), each a tick after the one before it.

    Knots over as many ticks, or fewer, come back as they are.
    """
    last = len(knots) - 1
    if ticks > last - 1e-9:
        return knots
    at = np.linspace(last - ticks, last, max(math.ceil(ticks), 1) + 1)
    return np.stack([np.interp(at, np.arange(last + 1), column) for column in knots.T], axis=1)


@njit
def deskew(
    ranges_m: Array, bearings_rad: Array, odometry: Array, lidar_x_m: float, no_echo_m: float
) -> tuple[Array, Array]:
    """(B, 2) beam ends and (B, 2) beam origins, all in the robot frame at the sweep's end [m].

    Each beam is placed where odometry says the robot was when it was shot; a beam without an echo ends after
    `no_echo_m`.
    """
    n, knots = ranges_m.shape[0], odometry.shape[0]
    points, origins = np.empty((n, 2)), np.empty((n, 2))
    end = odometry[knots - 1]
    c, s = math.cos(end[2]), math.sin(end[2])
    for i in range(n):
        at = i * (knots - 1) / n
        k = int(at)
        f = at - k
        dx = odometry[k, 0] + f * (odometry[k + 1, 0] - odometry[k, 0]) - end[0]
        dy = odometry[k, 1] + f * (odometry[k + 1, 1] - odometry[k, 1]) - end[1]
        yaw = odometry[k, 2] + f * (odometry[k + 1, 2] - odometry[k, 2]) - end[2]
        origins[i, 0] = c * dx + s * dy + lidar_x_m * math.cos(yaw)
        origins[i, 1] = -s * dx + c * dy + lidar_x_m * math.sin(yaw)
        r = ranges_m[i] if math.isfinite(ranges_m[i]) else no_echo_m
        points[i, 0] = origins[i, 0] + r * math.cos(yaw + bearings_rad[i])
        points[i, 1] = origins[i, 1] + r * math.sin(yaw + bearings_rad[i])
    return points, origins


@njit
def open_space(ranges_m: Array, run: int) -> NDArray[np.bool_]:
    """(B,) bool: beams without echo in a run of at least `run` such neighbours."""
    n = ranges_m.shape[0]
    found = np.zeros(n, np.bool_)
    length = 0
    # Round once more, so that a run across the first beam is seen whole.
    for i in range(2 * n):
        if not math.isinf(ranges_m[i % n]):
            length = 0
            continue
        length += 1
        if length == run:
            for k in range(run):
                found[(i - k) % n] = True
        elif length > run:
            found[i % n] = True
    return found


class LidarScan(NamedTuple):
    """A sweep as matching and mapping take it, all in the robot frame at its end."""

    points_m: Array  # (B, 2) beam ends
    origins_m: Array  # (B, 2) where the lidar was as each beam was shot
    normals: Array  # (B, 2) unit normals of the surface towards the lidar; zero where it has none
    sigma_m: Array  # (B,) of the ranges
    hits: NDArray[np.bool_]  # (B,) beams that end on a surface
    clears: NDArray[np.bool_]  # (B,) beams that end in open space


@dataclass(frozen=True, slots=True, kw_only=True)
class LidarGeometry:
    """How a lidar sits and measures.

    `sigma` is that of a range by the data sheet: hypot(first [m], second * range). A beam without echo clears
    the map as far as `no_echo_m`.
    """

    bearings_rad: Array
    x_m: float
    sigma: tuple[float, float]
    no_echo_m: float

    def scan(self, sweep: Sweep, parameters: SlamParameters) -> LidarScan:
        """Bring a sweep into the robot frame at its end."""
        points_m, origins_m = deskew(
            sweep.ranges_m, self.bearings_rad, sweep.odometry, self.x_m, self.no_echo_m
        )
        hits = np.isfinite(sweep.ranges_m)
        return LidarScan(
            points_m=points_m,
            origins_m=origins_m,
            normals=scan_normals(points_m, origins_m, hits, parameters.match.normal_radius_m),
            sigma_m=np.hypot(
                max(self.sigma[0], _LEAST_SIGMA_M), self.sigma[1] * np.where(hits, sweep.ranges_m, 0.0)
            ),
            hits=hits,
            clears=open_space(sweep.ranges_m, parameters.mapping.no_echo_run),
        )


class Slam:
    """Online SLAM: odometry prior, scan match, occupancy mapping. Map frame: the pose at the first sweep.

    `lidar_sigma` is the sigma of a range by the data sheet: hypot(first [m], second * range). A beam without
    echo clears the map as far as `no_echo_m`.
    """

    def __init__(
        self,
        *,
        bearings_rad: Array,
        lidar_x_m: float,
        lidar_sigma: tuple[float, float],
        no_echo_m: float,
        parameters: SlamParameters,
    ) -> None:
        self.parameters = parameters
        self._lidar = LidarGeometry(
            bearings_rad=bearings_rad, x_m=lidar_x_m, sigma=lidar_sigma, no_echo_m=no_echo_m
        )
        self._surface = SurfaceMap(
            extent_m=parameters.extent_m,
            cell_m=parameters.match.cell_m,
            same_side=parameters.match.same_side,
            max_weight=parameters.match.max_weight,
        )
        self.mapper = OccupancyMapper(extent_m=parameters.extent_m, parameters=parameters.mapping)
        self._pose: Array | None = None
        self._keyframe = np.zeros(3)
        self._odometry = np.zeros(3)
        self.points_m = np.zeros((0, 2))
        """(N, 2) surface points of the last sweep in the robot frame."""

    def update(self, sweep: Sweep) -> None:
        """Process one sweep."""
        p = self.parameters
        points_m, origins_m, normals, sigma_m, hits, clears = self._lidar.scan(sweep, p)
        odometry = sweep.odometry[-1]
        if self._pose is None:
            # The map's origin is where the sweep began; it ends where odometry has carried the robot.
            self._pose = relative(sweep.odometry[0], odometry)
            self._surface.insert(points_m, normals, sigma_m, self._pose)
            self._keyframe = self._pose
        else:
            travelled = relative(self._odometry, odometry)
            prior = compose(self._pose, travelled)
            self._pose, _ = match_scan(
                self._surface, points_m, normals, sigma_m, prior, travelled=travelled, parameters=p.match
            )
            moved = relative(self._keyframe, self._pose)
            if math.hypot(moved[0], moved[1]) > p.keyframe_m or abs(moved[2]) > p.keyframe_rad:
                self._surface.insert(points_m, normals, sigma_m, self._pose)
                self._keyframe = self._pose
        self._odometry = odometry
        self.mapper.integrate(points_m, origins_m, hits, clears, self._pose)
        self.points_m = points_m[hits]

    def has_started(self) -> bool:
        """Whether there has been a sweep."""
        return self._pose is not None

    def pose(self) -> Array:
        """(3,) x, y [m] and yaw [rad], unrolled, of the robot in its map at the end of the last sweep."""
        assert self._pose is not None
        return self._pose.copy()


def compose(a: Array, b: Array) -> Array:
    """(3,) pose a followed by b, yaw unrolled."""
    c, s = math.cos(a[2]), math.sin(a[2])
    return np.array([a[0] + c * b[0] - s * b[1], a[1] + s * b[0] + c * b[1], a[2] + b[2]])


def relative(a: Array, b: Array) -> Array:
    """(3,) pose b as seen from a, yaw unrolled."""
    c, s = math.cos(a[2]), math.sin(a[2])
    dx, dy = b[0] - a[0], b[1] - a[1]
    return np.array([c * dx + s * dy, -s * dx + c * dy, b[2] - a[2]])


class WheelOdometry:
    """Integrates wheel angles into a pose; the pose at the first reading is the origin."""

    def __init__(self, *, wheel_radius_m: float, track_m: float) -> None:
        self._radius_m = wheel_radius_m
        self._track_m = track_m
        self._last_rad: tuple[float, float] | None = None
        self._x_m = self._y_m = self._yaw_rad = 0.0

    def update(self, wheels_rad: tuple[float, float]) -> None:
        """Take the next reading: left and right wheel angle [rad]."""
        if self._last_rad is not None:
            left_m = self._radius_m * (wheels_rad[0] - self._last_rad[0])
            right_m = self._radius_m * (wheels_rad[1] - self._last_rad[1])
            turn = (right_m - left_m) / self._track_m
            heading = self._yaw_rad + 0.5 * turn
            forward_m = 0.5 * (left_m + right_m)
            self._x_m += forward_m * math.cos(heading)
            self._y_m += forward_m * math.sin(heading)
            self._yaw_rad += turn
        self._last_rad = wheels_rad

    def pose(self) -> Array:
        """(3,) x, y [m] and yaw [rad], unrolled, in the odometry frame."""
        return np.array([self._x_m, self._y_m, self._yaw_rad])
