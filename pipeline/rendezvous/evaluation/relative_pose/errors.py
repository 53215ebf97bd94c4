"""What an estimator of the relative pose read from each image, beside the truth."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import pandas as pd

from rendezvous.alignment.frame_error import ellipsoid_probability, frame_error, nees, pose_difference
from rendezvous.alignment.window import PAPER_XY_M, PAPER_YAW_RAD
from rendezvous.evaluation.json_record import FiniteOrNot, JsonRecord, OptionalArray, OptionalPose, Pose
from rendezvous.geometry.se2 import SE2, Array, wrap_angle
from rendezvous.pose_estimation.pose_estimate import RelativePose

CONFUSED_RAD = math.pi / 2.0
"""A larger heading error means that front and back of the robot were confused."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ImageTruth:
    """What an image shows."""

    image_id: str
    plan_id: str
    kind: str  # `plausible`, a training image that a robot could take, or `sighting`, taken at a rendezvous
    renderer: str  # `rasterised` or `path-traced`
    visibility: float  # visible share of robot 1's silhouette, 0 where it is absent or wholly hidden
    T_r0_r1: SE2 | None  # true relative pose, or None where robot 1 is absent
    distance_m: float  # from the camera to the centre of robot 1's cuboid; NaN where it is absent
    # Heading relative to the line of sight, left positive: 0 away from the camera, ±π towards it; NaN where
    # robot 1 is absent.
    heading_rad: float

    @property
    def shows_robot(self) -> bool:
        """Whether any of robot 1 is visible."""
        return self.T_r0_r1 is not None and self.visibility > 0.0


def as_seen(T_c_o: Array) -> tuple[float, float]:
    """Distance [m] of a cuboid with pose (4, 4), and its heading relative to the line of sight [rad]."""
    x_m, _, z_m = T_c_o[:3, 3]
    forward = T_c_o[:3, 0]
    # Left is -x of the camera.
    heading_rad = math.atan2(-forward[0], forward[2]) - math.atan2(-x_m, z_m)
    return float(np.linalg.norm(T_c_o[:3, 3])), wrap_angle(heading_rad)


@dataclass(frozen=True, slots=True, kw_only=True)
class PoseOutcome(JsonRecord):
    """What an estimator read from one image."""

    image_id: str
    T_r0_r1: OptionalPose = None  # the most probable reading, or None if the robot was not found
    covariance: OptionalArray = (
        None  # (3, 3) of the components of `T_r0_r1⁻¹ T_r0_r1_true`; None without a pose
    )
    degrees_of_freedom: FiniteOrNot = math.inf  # of the t distribution with this covariance
    T_c_o: OptionalArray = None  # (4, 4) pose of the cuboid that was read; None without a pose
    others: tuple[Pose, ...]  # the other readings, by falling probability
    score: float  # of the detection, in [0, 1]
    reason: str  # why there is no pose, or '' if there is one
    duration_s: float  # of the estimate alone
    # Whether a robot was also found in a copy of the image in which its surroundings cover it; None where
    # nothing of it is visible.
    found_covered: bool | None = None

    @staticmethod
    def of(
        image_id: str, pose: RelativePose, *, duration_s: float, found_covered: bool | None = None
    ) -> PoseOutcome:
        """The outcome of an estimate."""
        read: dict[str, Any] = {}
        if pose.found:
            names = ("T_r0_r1", "covariance", "degrees_of_freedom", "T_c_o")
            read = {name: getattr(pose.best, name) for name in names}
        return PoseOutcome(
            **read,
            image_id=image_id,
            others=tuple(mode.T_r0_r1 for mode in pose.modes[1:]),
            score=pose.score,
            reason=pose.reason,
            duration_s=duration_s,
            found_covered=found_covered,
        )


def pose_table(truths: Sequence[ImageTruth], outcomes: Sequence[PoseOutcome]) -> pd.DataFrame:
    """One row for each image: its truth, its outcome, and the error.

    Columns: the fields of `ImageTruth` without the pose; `score`, `reason`, `duration_s` and `found_covered`
    (null where no copy was covered) of `PoseOutcome`; and

    - shows_robot, found, detected: whether the robot is visible, a pose was read, and both.
    - dx_m, dy_m, dyaw_rad: components of T̂⁻¹ T, NaN unless detected, as all that follow.
    - position_m, turn_rad: distance of dx and dy, absolute dyaw.
    - confused, told_otherwise: the heading is off by more than `CONFUSED_RAD`; another reading's is not.
    - nees, ellipsoid: the error squared by the covariance, and the probability of the smallest ellipsoid that
      holds it.
    - offset_m, yaw_off_rad: distance and absolute yaw of the frame error (see `_theta`).
    - inside, inside_by_any: whether that lies in the window, by the first reading or by any.
    """
    assert [t.image_id for t in truths] == [o.image_id for o in outcomes], "outcomes of other images"
    rows = [_row(truth, outcome) for truth, outcome in zip(truths, outcomes, strict=True)]
    table = pd.DataFrame(rows).astype(
        {"found_covered": "boolean", "kind": "category", "renderer": "category"}
    )
    made = table.index[table.detected]
    covariance = np.array([outcomes[number].covariance for number in made]).reshape(-1, 3, 3)
    freedom = np.array([outcomes[number].degrees_of_freedom for number in made])
    table.loc[made, "nees"] = nees(table.loc[made, ["dx_m", "dy_m", "dyaw_rad"]].to_numpy(), covariance)
    table.loc[made, "ellipsoid"] = ellipsoid_probability(table.nees[made].to_numpy(), freedom)
    return table


def _row(truth: ImageTruth, outcome: PoseOutcome) -> dict[str, object]:
    detected = truth.shows_robot and outcome.T_r0_r1 is not None
    fields = {key: value for key, value in asdict(truth).items() if key != "T_r0_r1"}
    return {
        **fields,
        "shows_robot": truth.shows_robot,
        "found": outcome.T_r0_r1 is not None,
        "detected": detected,
        "found_covered": outcome.found_covered,
        "score": outcome.score,
        "reason": outcome.reason,
        "duration_s": outcome.duration_s,
        **(_NO_ERROR if not detected else _error(truth.T_r0_r1, outcome)),
    }


def _error(T_true: SE2 | None, outcome: PoseOutcome) -> dict[str, object]:
    """The columns of a detection's error."""
    assert T_true is not None
    assert outcome.T_r0_r1 is not None
    readings = (outcome.T_r0_r1, *outcome.others)
    error = pose_difference(outcome.T_r0_r1, T_true)
    off_rad = [abs(wrap_angle(T_hat.yaw_rad - T_true.yaw_rad)) for T_hat in outcome.others]
    confused = abs(error.yaw_rad) > CONFUSED_RAD
    thetas = [_theta(T_hat, T_true) for T_hat in readings]
    inside = [
        math.hypot(theta.x_m, theta.y_m) <= PAPER_XY_M and abs(theta.yaw_rad) <= PAPER_YAW_RAD
        for theta in thetas
    ]
    return {
        "dx_m": error.x_m,
        "dy_m": error.y_m,
        "dyaw_rad": error.yaw_rad,
        "position_m": math.hypot(error.x_m, error.y_m),
        "turn_rad": abs(error.yaw_rad),
        "confused": confused,
        "told_otherwise": confused and min(off_rad, default=math.inf) <= CONFUSED_RAD,
        "offset_m": math.hypot(thetas[0].x_m, thetas[0].y_m),
        "yaw_off_rad": abs(thetas[0].yaw_rad),
        "inside": inside[0],
        "inside_by_any": any(inside),
    }


_NO_ERROR: dict[str, object] = {
    **dict.fromkeys(("dx_m", "dy_m", "dyaw_rad", "position_m", "turn_rad"), math.nan),
    **dict.fromkeys(("offset_m", "yaw_off_rad", "nees", "ellipsoid"), math.nan),
    **dict.fromkeys(("confused", "told_otherwise", "inside", "inside_by_any"), False),
}


def _theta(T_hat: SE2, T_true: SE2) -> SE2:
    """The frame error θ of T̃ at the meeting point, up to the window's heading.

    T̃ is taken to be wrong by the relative pose alone, as if both SLAM poses were exact: `C⁻¹ (T̂ T⁻¹) C` in
    the axes of r0, with C where T̂ puts robot 1. Another heading of the window turns x and y only.
    """
    return frame_error(T_hat, T_true, SE2(T_hat.x_m, T_hat.y_m, 0.0))
