"""Calibration of relative poses: makes their stated confidence agree with their errors on validation images.

The accuracy of peaks is measured on the peaks themselves. Errors that all nine points share (a network that
overestimates the robot's size, a camera mounted a little higher than stated) show in no peak, so the
covariance is enlarged along and across the line of sight. Errors follow a Student's t distribution, since a
few poses are far worse than their peaks suggest. An exponent makes the probabilities of several readings
softer or sharper, and a score of detection is the probability that there is a robot where one was read.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from typing import Any

import numpy as np
from scipy.special import expit, logsumexp

from rendezvous.errors import ConfigError, require_within
from rendezvous.geometry.se2 import SE2, Array
from rendezvous.pose_estimation.cuboid_pose import Reading
from rendezvous.pose_estimation.keypoint_evidence import KeypointNoise

LEAST_READING_MASS = 0.01  # readings less probable than this are dropped


@dataclass(frozen=True, slots=True, kw_only=True)
class PoseCalibration:
    """How to interpret peaks and poses. The defaults suit a network that has not been calibrated."""

    # peak_floor_cells, peak_scale: fields of `KeypointNoise`.
    peak_floor_cells: float = 0.1
    peak_scale: float = 0.3
    scale: float = 1.0  # factor on the covariance from the peaks
    # along_share, across_share: standard deviations added along and across the line of sight, relative to the
    # distance.
    along_share: float = 0.02
    across_share: float = 0.005
    # floor_m, floor_rad: standard deviations added to x and y, and to yaw.
    floor_m: float = 0.003
    floor_rad: float = 0.02
    # Of the Student's t distribution with the resulting covariance; more than 2.
    degrees_of_freedom: float = 1000.0
    sharpness: float = 1.0  # exponent of the readings' probabilities
    # bias, of_explained, of_gain: constant and weights of the logistic score; see `score_features`.
    bias: float = -8.0
    of_explained: float = 20.0
    of_gain: float = 0.0
    least_score: float = 0.5  # score from which the robot counts as found

    def __post_init__(self) -> None:
        require_within(
            self,
            peak_floor_cells=(0.001, 10.0),
            peak_scale=(0.0, 100.0),
            scale=(0.001, 1000.0),
            along_share=(0.0, 10.0),
            across_share=(0.0, 10.0),
            floor_m=(0.0, 10.0),
            floor_rad=(0.0, 3.2),
            degrees_of_freedom=(2.01, 1e6),
            sharpness=(0.0, 100.0),
            bias=(-1e3, 1e3),
            of_explained=(-1e3, 1e3),
            of_gain=(-1e3, 1e3),
            least_score=(0.0, 1.0),
        )

    @property
    def noise(self) -> KeypointNoise:
        """Accuracy of peaks."""
        return KeypointNoise(floor_cells=self.peak_floor_cells, scale=self.peak_scale)

    def covariance(self, covariance: Array, T_r0_r1: SE2) -> Array:
        """(3, 3) calibrated covariance of a reading."""
        (out,) = self.covariances(covariance[None], T_r0_r1.as_array()[None])
        return out

    def covariances(self, covariance_N33: Array, T_r0_r1_N3: Array) -> Array:
        """(N, 3, 3) calibrated covariances of readings at (N, 3) x [m], y [m], yaw [rad]."""
        x_m, y_m, yaw_rad = T_r0_r1_N3.T
        distance_m, sight_rad = np.hypot(x_m, y_m), np.arctan2(y_m, x_m) - yaw_rad
        along = np.stack([np.cos(sight_rad), np.sin(sight_rad)], axis=-1)
        across = np.stack([-np.sin(sight_rad), np.cos(sight_rad)], axis=-1)
        out = self.scale * covariance_N33 + np.diag(np.square([self.floor_m, self.floor_m, self.floor_rad]))
        for direction, share in ((along, self.along_share), (across, self.across_share)):
            sigma_m = (share * distance_m)[:, None] * direction
            out[:, :2, :2] += sigma_m[:, :, None] * sigma_m[:, None, :]
        return out

    def masses(self, log_evidence: Sequence[float]) -> Array:
        """Probability of each reading."""
        sharp = self.sharpness * np.asarray(log_evidence, np.float64)
        masses: Array = np.exp(sharp - logsumexp(sharp))
        return masses

    def score(self, reading: Reading) -> float:
        """Probability that the robot is where this reading, the best of its image, puts it."""
        return float(expit(self.bias + np.dot((self.of_explained, self.of_gain), score_features(reading))))

    def as_dict(self) -> dict[str, float]:
        """Values by field name, for the weights' JSON."""
        return asdict(self)

    @staticmethod
    def from_dict(values: Mapping[str, Any]) -> PoseCalibration:
        """Inverse of `as_dict`.

        Raises:
            ConfigError: a field is missing or unknown, or a value is out of range.
        """
        expected = {field.name for field in fields(PoseCalibration)}
        if values.keys() != expected or not all(isinstance(v, int | float) for v in values.values()):
            raise ConfigError(
                f"relative-pose: calibration holds {dict(values)}; must hold numbers {sorted(expected)}"
            )
        return PoseCalibration(**values)


def score_features(reading: Reading) -> tuple[float, float]:
    """Features of the score: weight of the agreeing peaks, and a tenth of the log likelihood ratio."""
    return reading.explained, 0.1 * reading.gain
