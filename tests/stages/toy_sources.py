"""Estimators of the relative pose that know the truth, by the image that they are shown."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from rendezvous.geometry.camera import Image, PinholeCamera, se3_from_se2
from rendezvous.geometry.se2 import SE2, Array
from rendezvous.pose_estimation.pose_estimate import ImagePoseEstimator, PoseMode, RelativePose
from rendezvous.stages.training.seen_images import SeenImage


def _seen(pixels: Image) -> str:
    return hashlib.sha256(pixels.tobytes()).hexdigest()


@dataclass(frozen=True, slots=True, kw_only=True)
class ToySource:
    """Reads the truth, moved by an error; nothing where there is no robot.

    Attributes:
        truths: hashes of pixels, and the true poses.
        off: what the estimate lacks.
        finds: whether it finds any robot.
        makes_up: a pose for images without a robot.
        plans: digests of floor plans that it was trained on.
        size_m, T_r1_o: sides of the cuboid of the robot that it knows, and its pose on it.
        sigma: standard deviations that it tells.
    """

    truths: tuple[tuple[str, SE2], ...]
    off: SE2 = field(default_factory=SE2.identity)
    finds: bool = True
    makes_up: SE2 | None = None
    plans: tuple[str, ...] = ()
    size_m: tuple[float, float, float] = (0.3, 0.2, 0.1)
    T_r1_o: Array = field(default_factory=lambda: np.eye(4), compare=False)
    sigma: float = 0.05
    digest: str = "toy"

    @staticmethod
    def of(images: Sequence[SeenImage], **settings: Any) -> ToySource:
        seen = [(_seen(i.pixels()), i.truth.T_r0_r1) for i in images if i.truth.T_r0_r1 is not None]
        return ToySource(truths=tuple(seen), digest=repr(settings), **settings)

    def estimator(self, *, floor: bool) -> ImagePoseEstimator:
        def estimate(image: Image, camera: PinholeCamera, T_r0_c: Array) -> RelativePose:
            true = dict(self.truths).get(_seen(image), self.makes_up)
            if true is None or not self.finds:
                return RelativePose.not_found("a toy")
            # Without the floor it is off by twice as much.
            pose = true @ self.off.inverse() if floor else true @ self.off.inverse() @ self.off.inverse()
            T_c_o = np.linalg.inv(T_r0_c) @ se3_from_se2(pose)
            mode = PoseMode(T_r0_r1=pose, covariance=self.sigma**2 * np.eye(3), mass=1.0, T_c_o=T_c_o)
            return RelativePose(modes=(mode,), score=0.9, keypoints_px=np.full((9, 2), np.nan))

        return estimate

    def record(self) -> dict[str, Any]:
        robot = {"name": "toy", "size_m": list(self.size_m), "T_r1_o": self.T_r1_o}
        return {"data": {"plan_digests": list(self.plans)}, "robot": robot}
