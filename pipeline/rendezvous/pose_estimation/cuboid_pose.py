"""Belief maps to poses of the robot: every reading that the image leaves open, with its covariance.

On a flat floor, poses with three unknowns are searched exhaustively (`floor_search`). Otherwise, as in the
paper, poses with six unknowns come from perspective-n-point: over all points found, over all but one of
them, and over whole faces of the cuboid, each also turned by quarter turns, since the network may have
confused the sides. All candidates are refined on the full evidence (`state_refinement`), and those that
converge to one place count as one.

Legend: M candidate states of an `ObservationModel`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from rendezvous.geometry.camera import se3_from_se2
from rendezvous.geometry.cuboid import CUBOID_CORNER_SIGNS, cuboid_points, pose_from_cuboid
from rendezvous.geometry.se2 import SE2, Array
from rendezvous.pose_estimation.cuboids import DetectedCuboid
from rendezvous.pose_estimation.dope_labels import Maps
from rendezvous.pose_estimation.floor_search import floor_poses, same_place
from rendezvous.pose_estimation.keypoint_evidence import KeypointEvidence
from rendezvous.pose_estimation.look import STRIDE_PX, Look
from rendezvous.pose_estimation.observation_model import ObservationModel
from rendezvous.pose_estimation.peaks import Peaks
from rendezvous.pose_estimation.state_refinement import RefinedStates, refine

MOST_READINGS = 4
_LEAST_LOG_SHARE = -60.0  # what is read with less is improbable under any calibration
_SAME_SHARE, _SAME_HEADING_RAD = 0.03, 0.06
_FARTHEST_M = 100.0
_FACES = tuple(
    tuple(i for i, signs in enumerate(CUBOID_CORNER_SIGNS[:8]) if signs[axis] == side)
    for axis in range(3)
    for side in (-1, 1)
)
_QUARTERS_RAD = (0.0, 0.5 * np.pi, np.pi, -0.5 * np.pi)


@dataclass(frozen=True, slots=True, kw_only=True)
class Reading:
    """One way to read the evidence."""

    T_r0_r1: SE2  # pose of robot 1 on the floor, in robot 0's frame
    covariance: Array  # (3, 3) of the components of `T_r0_r1⁻¹ T_r0_r1_true`
    T_c_o: Array  # (4, 4) pose of the cuboid in the camera
    log_evidence: float  # log of the probability mass around it, up to a constant shared by all readings
    explained: float  # weight of the peaks that agree with it, mean over the maps, in [0, 1]
    gain: float  # log likelihood ratio of the maps with this robot to the maps without one


def readings_on_floor(
    model: ObservationModel, evidence: KeypointEvidence, look: Look, belief_9hw: Maps, peaks: Peaks
) -> list[Reading]:
    """Readings for robots on one level floor, the most probable first.

    Args:
        model: camera and robot.
        evidence: evidence from all looks.
        look, belief_9hw, peaks: the look in which poses are searched.
    """
    return _readings(model, evidence, floor_poses(model, look, belief_9hw, peaks), floor=True)


def readings_in_space(
    model: ObservationModel, evidence: KeypointEvidence, look: Look, cuboids: Sequence[DetectedCuboid]
) -> list[Reading]:
    """Readings for a robot at any height and tilt, the most probable first; only x, y and yaw are kept.

    Args:
        model: camera and robot.
        evidence: evidence from all looks.
        look: one of the looks.
        cuboids: detections in that look.
    """
    poses = [
        pose for cuboid in cuboids for pose in _poses(model, look.to_image(STRIDE_PX * cuboid.uv_cells_92))
    ]
    states = np.array([model.state(T_c_o) for T_c_o in poses]).reshape(-1, 6)
    return _readings(model, evidence, states, floor=False)


def _poses(model: ObservationModel, uv_92: Array) -> list[Array]:
    """Candidates for `T_c_o` by perspective-n-point."""
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
            _, rvecs, tvecs, _ = cv2.solvePnPGeneric(
                points[corners], np.ascontiguousarray(uv_92[corners]), camera.K(), None, flags=solver
            )
        except cv2.error:  # the points coincide or lie on one line
            continue
        for rvec, tvec in zip(rvecs, tvecs, strict=True):
            T_c_o = np.eye(4)
            T_c_o[:3, :3], T_c_o[:3, 3] = cv2.Rodrigues(rvec)[0], np.ravel(tvec)
            poses.append(T_c_o)
    ahead = [pose for pose in poses if np.isfinite(pose).all() and pose[2, 3] > 0.0]
    return [pose @ se3_from_se2(SE2(0.0, 0.0, yaw_rad)) for pose in ahead for yaw_rad in _QUARTERS_RAD]


def _readings(
    model: ObservationModel, evidence: KeypointEvidence, states_M6: Array, *, floor: bool
) -> list[Reading]:
    if not len(states_M6):
        return []
    found = refine(model, evidence, states_M6, floor=floor)
    states = found.states_M6
    usable = (model.points_c(states)[:, 8, 2] > 0.0) & np.isfinite(found.log_evidence_M)
    usable &= np.abs(states[:, :2]).max(axis=1) < _FARTHEST_M
    order = np.argsort(-found.log_evidence_M)
    left = order[usable[order]]
    kept = list[int]()
    while len(left) and len(kept) < MOST_READINGS:
        best = int(left[0])
        kept.append(best)
        same = same_place(states[left], states[best], _SAME_SHARE, _SAME_HEADING_RAD)
        likely = found.log_evidence_M[left] > found.log_evidence_M[kept[0]] + _LEAST_LOG_SHARE
        left = left[~same & likely]
    return [_reading(model, found, m) for m in kept]


def _reading(model: ObservationModel, found: RefinedStates, m: int) -> Reading:
    x_m, y_m, yaw_rad = found.states_M6[m, :3].tolist()
    # States vary along the axes of r0, errors of a pose along those of r1.
    R_r1_r0 = SE2(0.0, 0.0, yaw_rad).matrix().T
    return Reading(
        T_r0_r1=SE2(x_m, y_m, yaw_rad).wrapped(),
        covariance=R_r1_r0 @ found.covariance_M66[m, :3, :3] @ R_r1_r0.T,
        T_c_o=model.T_c_o(found.states_M6[m]),
        log_evidence=float(found.log_evidence_M[m]),
        explained=float(found.explained_M[m]),
        gain=float(found.gain_M[m]),
    )
