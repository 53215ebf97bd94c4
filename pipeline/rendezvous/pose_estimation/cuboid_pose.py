"""Belief maps of a look to poses of the robot: every reading that the image leaves open, with its covariance.

With a flat floor, poses of three unknowns are searched outright (`floor_search`). Without it, as in the
paper, poses of six unknowns come from perspective-n-point over the points found, over all but one of them,
over the cuboid's faces, and turned by what the network may have taken for one another. All are then refined
on all of the evidence (`refinement`), and those that end at one place are one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from rendezvous.geometry.cuboid import CUBOID_CORNER_SIGNS, cuboid_points, pose_from_cuboid
from rendezvous.geometry.se2 import SE2, Array, wrap_angle
from rendezvous.pose_estimation.cuboids import DetectedCuboid
from rendezvous.pose_estimation.dope_labels import Maps
from rendezvous.pose_estimation.floor_search import floor_poses, same_place
from rendezvous.pose_estimation.keypoint_evidence import KeypointEvidence
from rendezvous.pose_estimation.look import STRIDE_PX, Look
from rendezvous.pose_estimation.observation_model import ObservationModel
from rendezvous.pose_estimation.peaks import Peaks
from rendezvous.pose_estimation.state_refinement import RefinedStates, refine

MODES = 4
_LEAST_LOG_SHARE = -12.0
_SAME_SHARE, _SAME_HEADING_RAD = 0.03, 0.06
_FACES = tuple(
    tuple(i for i, signs in enumerate(CUBOID_CORNER_SIGNS[:8]) if signs[axis] == side)
    for axis in range(3)
    for side in (-1, 1)
)
_QUARTERS = (0.0, 0.5 * np.pi, np.pi, -0.5 * np.pi)


@dataclass(frozen=True, slots=True, kw_only=True)
class Reading:
    """One way to read the evidence.

    Attributes:
        T_r0_r1: robot 1 on the floor before robot 0.
        covariance: (3, 3) of the components of `T_r0_r1⁻¹ T_r0_r1_true`.
        T_c_o: (4, 4) pose of the cuboid in the camera.
        log_evidence: log of the probability that lies around it, up to a constant for all readings.
        explained: weight of the peaks that agree with it, mean over the maps, in [0, 1].
        gain: log of how much more probable the maps are with it than without a robot.
    """

    T_r0_r1: SE2
    covariance: Array
    T_c_o: Array
    log_evidence: float
    explained: float
    gain: float


def readings_on_floor(
    model: ObservationModel, evidence: KeypointEvidence, look: Look, belief_9hw: Maps, peaks: Peaks
) -> list[Reading]:
    """The readings of robots on one level floor, the most probable first.

    Args:
        model: camera and robot.
        evidence: of all looks.
        look, belief_9hw, peaks: one of the looks, that poses are searched in.
    """
    return _readings(model, evidence, floor_poses(model, look, belief_9hw, peaks), floor=True)


def readings_in_space(
    model: ObservationModel, evidence: KeypointEvidence, look: Look, cuboids: Sequence[DetectedCuboid]
) -> list[Reading]:
    """The readings of a robot at any height and tilt, the most probable first; x, y and yaw are kept of it.

    Args:
        model: camera and robot.
        evidence: of all looks.
        look: one of them.
        cuboids: what was found in it.
    """
    poses = [
        pose for cuboid in cuboids for pose in _poses(model, look.to_image(STRIDE_PX * cuboid.uv_cells_92))
    ]
    states = np.array([model.state(T_c_o) for T_c_o in poses]).reshape(-1, 6)
    return _readings(model, evidence, states, floor=False)


def _poses(model: ObservationModel, uv_92: Array) -> list[Array]:
    """`T_c_o` by perspective-n-point from all points, all but one, and the faces, each also turned."""
    size_m, camera = model.robot.size_m, model.camera
    known = np.flatnonzero(np.isfinite(uv_92).all(axis=1))
    subsets = [uv_92]
    for left_out in known:
        rest = uv_92.copy()
        rest[left_out] = np.nan
        subsets.append(rest)
    poses = [pose for uv in subsets if (pose := pose_from_cuboid(uv, size_m, camera)) is not None]
    points = cuboid_points(size_m)
    whole = [list(face) for face in _FACES if set(face) <= set(known.tolist())]
    solvers = [(face, cv2.SOLVEPNP_IPPE) for face in whole]
    if len(known) >= 5:
        solvers.append((known.tolist(), cv2.SOLVEPNP_EPNP))
    for corners, solver in solvers:
        try:
            _, turns, places, _ = cv2.solvePnPGeneric(
                points[corners], np.ascontiguousarray(uv_92[corners]), camera.K(), None, flags=solver
            )
        except cv2.error:  # points that lie in one place or on one line
            continue
        poses += [_pose(rvec, tvec) for rvec, tvec in zip(turns, places, strict=True)]
    ahead = [pose for pose in poses if np.isfinite(pose).all() and pose[2, 3] > 0.0]
    return [pose @ _turned(quarter) for pose in ahead for quarter in _QUARTERS]


def _pose(rvec: Array, tvec: Array) -> Array:
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = cv2.Rodrigues(rvec)[0], np.ravel(tvec)
    return T


def _turned(yaw_rad: float) -> Array:
    T = np.eye(4)
    c, s = np.cos(yaw_rad), np.sin(yaw_rad)
    T[:2, :2] = [[c, -s], [s, c]]
    return T


def _readings(
    model: ObservationModel, evidence: KeypointEvidence, states_M6: Array, *, floor: bool
) -> list[Reading]:
    if not len(states_M6):
        return []
    found = refine(model, evidence, states_M6, floor=floor)
    ahead = model.points_c(found.states_M6)[:, 8, 2] > 0.0
    usable = ahead & np.isfinite(found.log_evidence_M) & (np.abs(found.states_M6[:, :2]).max(axis=1) < 100.0)
    order = np.argsort(-found.log_evidence_M)
    left = order[usable[order]]
    kept = list[int]()
    while len(left) and len(kept) < MODES:
        best = int(left[0])
        kept.append(best)
        same = same_place(found.states_M6[left], found.states_M6[best], _SAME_SHARE, _SAME_HEADING_RAD)
        likely = found.log_evidence_M[left] > found.log_evidence_M[kept[0]] + _LEAST_LOG_SHARE
        left = left[~same & likely]
    return [_reading(model, found, m) for m in kept]


def _reading(model: ObservationModel, found: RefinedStates, m: int) -> Reading:
    state = found.states_M6[m]
    x_m, y_m, yaw_rad = state[:3].tolist()
    # From the axes of r0, in which states are, to those of r1.
    c, s = np.cos(yaw_rad), np.sin(yaw_rad)
    R = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
    return Reading(
        T_r0_r1=SE2(x_m, y_m, wrap_angle(yaw_rad)),
        covariance=R @ found.covariance_M66[m, :3, :3] @ R.T,
        T_c_o=model.T_c_o(state),
        log_evidence=float(found.log_evidence_M[m]),
        explained=float(found.explained_M[m]),
        gain=float(found.gain_M[m]),
    )
