"""What became of each image under an estimator of the relative pose: its pose beside the true one."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from rendezvous.alignment.frame_error import frame_error, pose_difference
from rendezvous.geometry.occupancy_grid import Mask
from rendezvous.geometry.se2 import SE2, Array, wrap_angle
from rendezvous.pose_estimation.pose_estimate import RelativePose

CONFUSED_RAD = math.pi / 2.0
"""A heading that is wrong by more takes the robot's back for its front."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ImageTruth:
    """What is known of an image.

    Attributes:
        image_id: unique name.
        plan_id: of the floor plan.
        kind: `plausible`, an image to train on that a robot took, or `sighting`, of a rendezvous.
        visibility: visible share of robot 1's silhouette, 0 where it is absent or wholly hidden.
        T_r0_r1: the true relative pose; None where robot 1 is absent.
        distance_m: from the camera to the centre of its cuboid; NaN where it is absent.
        heading_rad: which way it faces, from the line of sight, left positive: 0 away from the camera, ±π
            towards it; NaN where it is absent.
    """

    image_id: str
    plan_id: str
    kind: str
    visibility: float
    T_r0_r1: SE2 | None
    distance_m: float
    heading_rad: float

    @property
    def shows_robot(self) -> bool:
        """Whether something of robot 1 is to be seen."""
        return self.T_r0_r1 is not None and self.visibility > 0.0


def as_seen(T_c_o: Array) -> tuple[float, float]:
    """Distance [m] of a cuboid (4, 4) and which way it faces from the line of sight [rad]."""
    x_m, _, z_m = T_c_o[:3, 3]
    forward = T_c_o[:3, 0]
    # Left is -x of the camera.
    heading_rad = math.atan2(-forward[0], forward[2]) - math.atan2(-x_m, z_m)
    return float(np.linalg.norm(T_c_o[:3, 3])), wrap_angle(heading_rad)


@dataclass(frozen=True, slots=True, kw_only=True)
class PoseOutcome:
    """What an estimator read from one image.

    Attributes:
        image_id: of the image.
        T_r0_r1: its most probable reading; None if the robot was not found.
        covariance: (3, 3) of the components of `T_r0_r1⁻¹ T_r0_r1_true`; None without a pose.
        degrees_of_freedom: of the t distribution that has this covariance; infinite: a normal one.
        T_c_o: (4, 4) pose of the cuboid that it read; None without a pose.
        others: its other readings, by falling probability.
        mass: probability of the first reading; 0 without a pose.
        score: of the detection, in [0, 1].
        reason: why there is no pose; empty if there is one.
        duration_s: of the estimate alone.
        found_covered: whether a robot was found as well in a copy in which it is covered by what is beside
            it; None where nothing of it is to be seen.
    """

    image_id: str
    T_r0_r1: SE2 | None
    covariance: Array | None
    degrees_of_freedom: float
    T_c_o: Array | None
    others: tuple[SE2, ...]
    mass: float
    score: float
    reason: str
    duration_s: float
    found_covered: bool | None = None

    @staticmethod
    def of(
        image_id: str, pose: RelativePose, *, duration_s: float, found_covered: bool | None = None
    ) -> PoseOutcome:
        """What is kept of an estimate."""
        best = pose.best if pose.found else None
        return PoseOutcome(
            image_id=image_id,
            T_r0_r1=None if best is None else best.T_r0_r1,
            covariance=None if best is None else best.covariance,
            degrees_of_freedom=math.inf if best is None else best.degrees_of_freedom,
            T_c_o=None if best is None else best.T_c_o,
            others=tuple(mode.T_r0_r1 for mode in pose.modes[1:]),
            mass=0.0 if best is None else best.mass,
            score=pose.score,
            reason=pose.reason,
            duration_s=duration_s,
            found_covered=found_covered,
        )

    def to_json(self) -> dict[str, Any]:
        """Values as JSON holds them."""
        return {
            "image_id": self.image_id,
            "T_r0_r1": self.T_r0_r1 and self.T_r0_r1.as_array().tolist(),
            "covariance": None if self.covariance is None else self.covariance.tolist(),
            "degrees_of_freedom": self.degrees_of_freedom if math.isfinite(self.degrees_of_freedom) else None,
            "T_c_o": None if self.T_c_o is None else self.T_c_o.tolist(),
            "others": [pose.as_array().tolist() for pose in self.others],
            "mass": self.mass,
            "score": self.score,
            "reason": self.reason,
            "duration_s": self.duration_s,
            "found_covered": self.found_covered,
        }

    @staticmethod
    def from_json(fields: Mapping[str, Any]) -> PoseOutcome:
        """Inverse of `to_json`."""
        pose, tails = fields["T_r0_r1"], fields["degrees_of_freedom"]
        arrays = {
            name: None if fields[name] is None else np.array(fields[name]) for name in ("covariance", "T_c_o")
        }
        return PoseOutcome(
            **{
                **fields,
                **arrays,
                "degrees_of_freedom": math.inf if tails is None else tails,
                "T_r0_r1": None if pose is None else SE2.from_array(pose),
                "others": tuple(SE2.from_array(other) for other in fields["others"]),
            }
        )


@dataclass(frozen=True)
class PoseOutcomes:
    """All outcomes of one estimator beside the truth, as columns; N images in one order."""

    truths: tuple[ImageTruth, ...]
    rows: tuple[PoseOutcome, ...]

    def __post_init__(self) -> None:
        ids = [[each.image_id for each in column] for column in (self.truths, self.rows)]
        assert ids[0] == ids[1], "outcomes of other images"

    def __len__(self) -> int:
        return len(self.rows)

    @cached_property
    def shows_robot(self) -> Mask:
        """(N,) where something of robot 1 is to be seen."""
        return np.array([truth.shows_robot for truth in self.truths], dtype=bool)

    @cached_property
    def found(self) -> Mask:
        """(N,) where there is a pose."""
        return np.array([row.T_r0_r1 is not None for row in self.rows], dtype=bool)

    @cached_property
    def covered(self) -> Mask:
        """(N,) where a copy without the robot was looked at as well."""
        return np.array([row.found_covered is not None for row in self.rows], dtype=bool)

    @cached_property
    def found_covered(self) -> Mask:
        """(N,) where there is a pose in that copy."""
        return np.array([bool(row.found_covered) for row in self.rows], dtype=bool)

    @cached_property
    def detected(self) -> Mask:
        """(N,) where the robot is to be seen and there is a pose."""
        return self.shows_robot & self.found

    @cached_property
    def error(self) -> Array:
        """(N, 3) components x [m], y [m], yaw [rad] of T̂⁻¹ T; NaN where nothing was detected."""
        return self._per_detection(lambda T_hat, T: pose_difference(T_hat, T).as_array())

    @cached_property
    def position_m(self) -> Array:
        """(N,) distance of the error's x and y."""
        return np.hypot(self.error[:, 0], self.error[:, 1])

    @cached_property
    def heading_rad(self) -> Array:
        """(N,) absolute yaw of the error."""
        return np.abs(self.error[:, 2])

    @cached_property
    def confused(self) -> Mask:
        """(N,) where the heading is wrong by more than a right angle."""
        return self.heading_rad > CONFUSED_RAD

    @cached_property
    def told_otherwise(self) -> Mask:
        """(N,) where the heading is confused, and another reading has it nearer than a right angle."""
        return np.array(
            [
                confused and truth.T_r0_r1 is not None and _near(row.others, truth.T_r0_r1)
                for confused, row, truth in zip(self.confused, self.rows, self.truths, strict=True)
            ],
            dtype=bool,
        )

    @cached_property
    def covariance(self) -> Array:
        """(N, 3, 3); NaN where nothing was detected."""
        missing = np.full((3, 3), np.nan)
        pairs = zip(self.rows, self.detected, strict=True)
        return np.array([row.covariance if d else missing for row, d in pairs]).reshape(-1, 3, 3)

    @cached_property
    def degrees_of_freedom(self) -> Array:
        """(N,) of the t distributions that have these covariances."""
        return np.array([row.degrees_of_freedom for row in self.rows])

    @cached_property
    def theta(self) -> Array:
        """(N, 3) the frame error θ_w that T̃ has at the meeting point, but for the window's heading.

        T̃ is wrong by the relative pose alone here, as if both SLAM poses were exact: `C⁻¹ (T̂ T⁻¹) C` in the
        axes of r0, with C where T̂ puts robot 1. Another heading of the window turns x and y only.
        """
        return self._per_detection(_theta)

    def thetas(self, number: int) -> Array:
        """(M, 3) the same of all readings of one image in which the robot was detected."""
        row, true = self.rows[number], self.truths[number].T_r0_r1
        assert row.T_r0_r1 is not None
        assert true is not None
        return np.array([_theta(pose, true) for pose in (row.T_r0_r1, *row.others)])

    @cached_property
    def duration_s(self) -> Array:
        """(N,) of each estimate."""
        return np.array([row.duration_s for row in self.rows])

    def truth(self, name: str) -> Array:
        """(N,) numbers of `ImageTruth`."""
        return np.array([getattr(truth, name) for truth in self.truths], dtype=np.float64)

    def of_kind(self, kind: str) -> Mask:
        """(N,) which images are of a kind."""
        return np.array([truth.kind == kind for truth in self.truths], dtype=bool)

    def _per_detection(self, components: Callable[[SE2, SE2], Array]) -> Array:
        """(N, 3) of the estimated and the true pose; NaN where nothing was detected."""
        out = np.full((len(self), 3), np.nan)
        for number in np.flatnonzero(self.detected):
            T_hat, true = self.rows[number].T_r0_r1, self.truths[number].T_r0_r1
            assert T_hat is not None
            assert true is not None
            out[number] = components(T_hat, true)
        return out


def _theta(T_hat: SE2, T_true: SE2) -> Array:
    return frame_error(T_hat, T_true, SE2(T_hat.x_m, T_hat.y_m, 0.0)).as_array()


def _near(readings: Sequence[SE2], true: SE2) -> bool:
    return any(abs(wrap_angle(pose.yaw_rad - true.yaw_rad)) <= CONFUSED_RAD for pose in readings)
