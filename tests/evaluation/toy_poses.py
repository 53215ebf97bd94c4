"""Images and poses made of numbers."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import pandas as pd

from rendezvous.evaluation.relative_pose.errors import ImageTruth, PoseOutcome, as_seen, pose_table
from rendezvous.geometry.camera import camera_pose, se3_from_se2
from rendezvous.geometry.se2 import SE2
from rendezvous.pose_estimation.pose_estimate import PoseMode, RelativePose

T_R0_C = camera_pose(np.array([0.03, 0.0, 0.12]), np.zeros(3))


def truth(
    number: int,
    T_r0_r1: SE2 | None,
    *,
    visibility: float = 1.0,
    kind: str = "plausible",
    renderer: str = "rasterised",
) -> ImageTruth:
    """A robot at that pose, or none."""
    seen = (math.nan, math.nan) if T_r0_r1 is None else as_seen(np.linalg.inv(T_R0_C) @ se3_from_se2(T_r0_r1))
    return ImageTruth(
        image_id=f"image-{number}",
        plan_id=f"plan-{number // 2}",
        kind=kind,
        renderer=renderer,
        visibility=0.0 if T_r0_r1 is None else visibility,
        T_r0_r1=T_r0_r1,
        distance_m=seen[0],
        heading_rad=seen[1],
    )


def mode(
    T_r0_r1: SE2, *, mass: float = 1.0, sigma: float = 0.1, degrees_of_freedom: float = math.inf
) -> PoseMode:
    """A reading."""
    return PoseMode(
        T_r0_r1=T_r0_r1,
        covariance=sigma**2 * np.eye(3),
        mass=mass,
        T_c_o=np.linalg.inv(T_R0_C) @ se3_from_se2(T_r0_r1),
        degrees_of_freedom=degrees_of_freedom,
    )


def read_as(*modes: PoseMode, score: float = 0.9) -> RelativePose:
    """An estimate with these readings; none: not found."""
    if not modes:
        return RelativePose.not_found("a toy")
    return RelativePose(modes=modes, score=score, keypoints_px=np.full((9, 2), np.nan))


def outcomes(truths: Sequence[ImageTruth], poses: Sequence[RelativePose]) -> pd.DataFrame:
    """The table of these estimates."""
    rows = [
        PoseOutcome.of(truth.image_id, pose, duration_s=0.1)
        for truth, pose in zip(truths, poses, strict=True)
    ]
    return pose_table(truths, rows)


def drawn_truths(count: int) -> list[ImageTruth]:
    """Robots ahead at 0.5 to 4 m, at any heading, more or less visible, all uniform."""
    low, high = (0.5, -0.3, -3.1, 0.05), (4.0, 0.3, 3.1, 1.0)
    drawn = np.random.default_rng(0).uniform(low, high, (count, 4))
    return [truth(number, SE2(*pose), visibility=seen) for number, (*pose, seen) in enumerate(drawn)]
