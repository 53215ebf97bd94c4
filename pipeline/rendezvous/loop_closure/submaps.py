"""A path in submaps: each scan is matched only with what was seen shortly before.

Drift then bends the path between submaps and not the walls within one (Hess et al., "Real-time loop closure
in 2D lidar SLAM", ICRA 2016). Two submaps grow at a time, the second from halfway through the first, so that
no scan is matched with an empty one.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rendezvous.geometry.se2 import Array
from rendezvous.slam.scan_match import registered
from rendezvous.slam.slam import LidarScan, SlamParameters, compose, relative
from rendezvous.slam.surface_map import Surface, SurfaceMap

REACH_M = 30.0  # what is farther from the lidar is not in submaps
_OVERCONFIDENCE = 9.0  # points of a scan do not err independently: what their information is too large by
_LEAST_SHARE = 0.7  # of a scan's points with normals that match; with fewer, other headings are tried
_TURNS_RAD = (0.0, *(math.radians(turn) for turn in (-5.0, 5.0, -10.0, 10.0)))  # from odometry's heading
_TIMES_MORE, _POINTS_MORE = 1.3, 5  # points that must match at another heading for it to be better
_SLIP_RAD_PER_M = 0.01  # of odometry's yaw on the way, which the parameters of scan matching leave out
_LEAST_DRIFT = np.diag([1e-6, 1e-6, 1e-8])  # covariance of a step that no scan was inserted on


@dataclass(frozen=True, slots=True, kw_only=True)
class Submap:
    """What was seen on a few metres of the path, in the frame of its first scan's pose."""

    scans: NDArray[np.int64]  # (N,) numbers of the scans in it, one after the other
    poses: Array  # (N, 3) x, y [m], yaw [rad] of each
    surface: Surface

    def centre(self) -> Array:
        """(2,) the middle of its path."""
        return np.asarray(self.poses[:, :2].mean(axis=0))


@dataclass(frozen=True, slots=True, kw_only=True)
class SubmapPath:
    """A path in submaps."""

    submaps: list[Submap]
    home: NDArray[np.int64]  # (N,) submap that each scan was matched with
    # steps: (M - 1, 3) each submap's frame as seen from the one before; covariances: (M - 1, 3, 3) of these.
    steps: Array
    covariances: Array

    def poses(self, frames: Array) -> Array:
        """(N, 3) poses of all scans, submaps' frames being at (M, 3)."""
        out = np.empty((len(self.home), 3))
        for number, submap in enumerate(self.submaps):
            for scan, pose in zip(submap.scans, submap.poses, strict=True):
                if self.home[scan] == number:
                    out[scan] = compose(frames[number], pose)
        return out

    def frames(self) -> Array:
        """(M, 3) frames as they follow from the steps."""
        out = [np.zeros(3)]
        for step in self.steps:
            out.append(compose(out[-1], step))
        return np.array(out)


class _Growing:
    """A submap that is not finished."""

    def __init__(self, parameters: SlamParameters, extent_m: float) -> None:
        match = parameters.match
        self.map = SurfaceMap(
            extent_m=extent_m, cell_m=match.cell_m, same_side=match.same_side, max_weight=match.max_weight
        )
        self.scans: list[int] = []
        self.poses: list[Array] = []
        self.travelled_m = 0.0

    def add(self, number: int, scan: LidarScan, pose: Array, *, insert: bool) -> None:
        if self.poses:
            self.travelled_m += math.dist(self.poses[-1][:2], pose[:2])
        self.scans.append(number)
        self.poses.append(pose)
        if insert:
            near = np.hypot(*(scan.points_m - scan.origins_m).T) < REACH_M
            self.map.insert(scan.points_m[near], scan.normals[near], scan.sigma_m[near], pose)

    def finished(self) -> Submap:
        return Submap(scans=np.array(self.scans), poses=np.array(self.poses), surface=self.map.cropped())


class SubmapTracker:
    """Follows scans and grows submaps."""

    def __init__(self, parameters: SlamParameters, *, length_m: float) -> None:
        self._parameters, self._length_m = parameters, length_m
        self._growing: list[_Growing] = []  # the first is matched with
        self._T_0_1 = np.zeros(3)  # the second's frame in the first's
        self._pose = self._keyframe = np.zeros(3)  # of the last scan and the last one inserted, in the first
        self._drift = np.zeros((3, 3))  # covariance of the keyframe, seen from the youngest submap's frame
        self._odometry = np.zeros(3)
        self._count = 0
        self.done: list[Submap] = []
        self.home: list[int] = []
        self.steps: list[Array] = []
        self.covariances: list[Array] = []

    def add(self, scan: LidarScan, odometry: Array) -> None:
        """Take the next scan; odometry (3,) as it ended, in any fixed frame."""
        keyframe = True
        if self._growing:
            keyframe = self._match(scan, relative(self._odometry, odometry))
        self._odometry = odometry
        self.home.append(len(self.done))
        for growing, T_0 in zip(self._growing, (np.zeros(3), self._T_0_1), strict=False):
            growing.add(self._count, scan, relative(T_0, self._pose), insert=keyframe)
        if not self._growing or self._growing[-1].travelled_m >= self._length_m:
            self._begin(scan)
        self._count += 1

    def path(self) -> SubmapPath:
        """All submaps, the growing ones as they are."""
        return SubmapPath(
            submaps=[*self.done, *(growing.finished() for growing in self._growing)],
            home=np.array(self.home),
            steps=np.array(self.steps).reshape(-1, 3),
            covariances=np.array(self.covariances).reshape(-1, 3, 3),
        )

    def _match(self, scan: LidarScan, travelled: Array) -> bool:
        """Find the scan's pose; whether it has moved enough to be inserted."""
        parameters = self._parameters
        self._pose, information = self._registered(scan, compose(self._pose, travelled), travelled)
        moved = relative(self._keyframe, self._pose)
        if (
            math.hypot(moved[0], moved[1]) <= parameters.keyframe_m
            and abs(moved[2]) <= parameters.keyframe_rad
        ):
            return False
        own = covariance_of(information, self._pose)
        carry = carried(moved)
        self._drift = carry @ self._drift @ carry.T + own
        self._keyframe = self._pose
        return True

    def _registered(self, scan: LidarScan, prior: Array, travelled: Array) -> tuple[Array, Array]:
        """The pose and its information; where few points match, from other headings too."""
        p = self._parameters.match
        sigma_xy_m, sigma_yaw_rad = p.prior_sigmas(travelled)
        sigma_yaw_rad += _SLIP_RAD_PER_M * math.hypot(travelled[0], travelled[1])
        points = np.count_nonzero(np.abs(scan.normals).sum(axis=1))
        best = None
        for turn_rad in _TURNS_RAD:
            found = registered(
                self._growing[0].map.surface, scan.points_m, scan.normals, scan.sigma_m,
                prior + np.array([0.0, 0.0, turn_rad]), sigma_xy_m=sigma_xy_m, sigma_yaw_rad=sigma_yaw_rad,
                gate_m=p.gate_m, iterations=p.iterations,
            )  # fmt: skip
            if best is None or found[2] > _TIMES_MORE * best[2] + _POINTS_MORE:
                best = found
            if best[2] >= _LEAST_SHARE * points:
                break
        assert best is not None
        return best[0], best[1]

    def _begin(self, scan: LidarScan) -> None:
        """Begin a submap at the last scan; the oldest of two is finished."""
        if len(self._growing) == 2:
            self.done.append(self._growing.pop(0).finished())
            self._pose = relative(self._T_0_1, self._pose)
            self._keyframe = relative(self._T_0_1, self._keyframe)
        if self._growing:
            self.steps.append(self._pose)
            self.covariances.append(self._drift + _LEAST_DRIFT)
        self._T_0_1, self._drift = self._pose, np.zeros((3, 3))
        growing = _Growing(self._parameters, 2.0 * (REACH_M + 2.0 * self._length_m))
        growing.add(self._count, scan, np.zeros(3), insert=True)
        self._growing.append(growing)


def axes_turned(yaw_rad: Array) -> Array:
    """(..., 3, 3) that bring x, y, yaw into axes turned by angles (...)."""
    c, s = np.cos(yaw_rad), np.sin(yaw_rad)
    R = np.zeros((*np.shape(yaw_rad), 3, 3))
    R[..., 0, 0], R[..., 0, 1], R[..., 1, 0], R[..., 1, 1], R[..., 2, 2] = c, s, -s, c, 1.0
    return R


def carried(motion: Array) -> Array:
    """(3, 3) that carries a small motion before `motion` to the same one after it."""
    x, y, yaw_rad = motion
    return np.asarray(axes_turned(yaw_rad) @ [[1.0, 0.0, -y], [0.0, 1.0, x], [0.0, 0.0, 1.0]])


def covariance_of(information: Array, poses: Array) -> Array:
    """(..., 3, 3) covariance of registered poses (..., 3) in their own axes, from what `registered` gives."""
    R = axes_turned(poses[..., 2])
    return np.asarray(_OVERCONFIDENCE * R @ np.linalg.inv(information) @ np.swapaxes(R, -1, -2))


def honest(information: Array, poses: Array, *, bent: tuple[float, float]) -> Array:
    """(..., 3, 3) information of registered poses in their own axes, walls being bent by sigmas [m, rad]."""
    added = np.diag(np.square([bent[0], bent[0], bent[1]]))
    return np.asarray(np.linalg.inv(covariance_of(information, poses) + added))
