"""Fits a `PoseCalibration` to images whose truth is known.

First the accuracy of peaks; then, with poses read under it, the score of detection, the spread of poses and
the sharpness of their probabilities: each by maximum likelihood of the truth.

Legend: N images, M readings of an image.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import minimize
from scipy.special import expit, log_softmax, logsumexp

from rendezvous.alignment.frame_error import log_density
from rendezvous.geometry.occupancy_grid import Mask
from rendezvous.geometry.se2 import SE2, Array
from rendezvous.pose_estimation.cuboid_pose import Reading
from rendezvous.pose_estimation.keypoint_evidence import KeypointNoise, evidence_of
from rendezvous.pose_estimation.look import Look
from rendezvous.pose_estimation.peaks import Peaks
from rendezvous.pose_estimation.pose_calibration import PoseCalibration, score_features

SAME_M, SAME_SHARE = 0.3, 0.15
"""A reading is of the robot itself if it is within one of these distances; the latter is relative to the
robot's distance."""
SAME_READING_RAD = 0.25 * np.pi  # a reading whose heading is off by more confused the robot's sides
FALSE_SHARE = 0.005
"""Share of images without the robot in which one may be found: half of what is required, as few images
decide it."""
SHARPNESSES = tuple(float(s) for s in np.geomspace(0.01, 100.0, 49))
"""Candidates. The prior on the log is normal about 0 with a standard deviation of 1, which matters where few
images have several readings."""
LEAST_LOG_LIKELIHOOD = -20.0
"""Lower limit per image: where no reading holds the truth, the image is no evidence about sharpness."""
_FIRST_SPREAD = (1.0, 0.02, 0.005, 0.003, 0.01, 3.0)
"""Scale, shares along and across, floor of x and y [m], of yaw [rad], degrees of freedom above 2."""
_LIMITS = np.log([(0.05, 50.0), (1e-4, 0.5), (1e-4, 0.5), (1e-4, 0.3), (1e-4, 1.0), (0.1, 1e3)])
_NOISE_LIMITS = np.log([(0.01, 3.0), (0.001, 30.0)])
_RIDGE = 1e-3


@dataclass(frozen=True, slots=True, kw_only=True)
class SeenPeaks:
    """A close look at the robot."""

    look: Look  # the part of the image
    peaks: Peaks  # peaks found there
    uv_px: Array  # (9, 2) true points in the image


@dataclass(frozen=True, slots=True, kw_only=True)
class ReadImage:
    """The readings of an image."""

    readings: tuple[Reading, ...]  # the most probable first; none if nothing looked like the robot
    T_r0_r1: SE2 | None  # the true pose; None without a robot

    @property
    def right(self) -> bool:
        """Whether the best reading is of the robot itself, whichever way it faces."""
        return bool(self.readings) and self.T_r0_r1 is not None and _is_at(self.readings[0], self.T_r0_r1)

    def errors_M3(self) -> Array:
        """(M, 3) components of `T_r0_r1⁻¹ T_r0_r1_true` of each reading."""
        assert self.T_r0_r1 is not None
        return np.array(
            [(one.T_r0_r1.inverse() @ self.T_r0_r1).wrapped().as_array() for one in self.readings]
        )


def likeliest_noise(seen: Sequence[SeenPeaks], *, sigma_cells: float) -> KeypointNoise:
    """The accuracy of peaks under which the true points are most likely."""

    def noise(logs: Array) -> KeypointNoise:
        floor_cells, scale = np.exp(np.clip(logs, *_NOISE_LIMITS.T))
        return KeypointNoise(floor_cells=float(floor_cells), scale=float(scale))

    def cost(logs: Array) -> float:
        tried = noise(logs)
        likelihoods = [
            evidence_of([(one.look, one.peaks)], sigma_cells=sigma_cells, noise=tried).log_likelihood(
                one.uv_px[None]
            )[0]
            for one in seen
        ]
        return -float(np.mean(likelihoods))

    first = np.log([KeypointNoise().floor_cells, KeypointNoise().scale])
    return noise(minimize(cost, first, method="Nelder-Mead", options={"xatol": 0.02, "fatol": 1e-3}).x)


def fitted(noise: KeypointNoise, images: Sequence[ReadImage]) -> PoseCalibration:
    """The best-fitting calibration.

    Args:
        noise: accuracy of peaks under which the images were read.
        images: with and without the robot; some must be right.
    """
    calibration = with_score(
        PoseCalibration(peak_floor_cells=noise.floor_cells, peak_scale=noise.scale), images
    )
    right = [
        image
        for image in images
        if image.right and calibration.score(image.readings[0]) >= calibration.least_score
    ]
    return with_sharpness(with_spread(calibration, right), right)


def with_score(calibration: PoseCalibration, images: Sequence[ReadImage]) -> PoseCalibration:
    """The calibration with a logistic regression of being right, and a threshold for few false finds."""
    read = [image for image in images if image.readings]
    features = np.array([[1.0, *score_features(image.readings[0])] for image in read])
    right = np.array([image.right for image in read])

    def cost(weights: Array) -> float:
        margin = np.where(right, 1.0, -1.0) * (features @ weights)
        return float(np.logaddexp(0.0, -margin).mean() + _RIDGE * (weights[1:] ** 2).mean())

    # More agreement must never count against a robot, however few images suggest it.
    bounds = [(None, None)] + [(0.0, None)] * (features.shape[1] - 1)
    weights = minimize(cost, np.zeros(features.shape[1]), method="L-BFGS-B", bounds=bounds).x
    least = _least_score(expit(features @ weights), right, len(images) - sum(i.right for i in images))
    bias, of_explained, of_gain = (float(w) for w in weights)
    return replace(calibration, bias=bias, of_explained=of_explained, of_gain=of_gain, least_score=least)


def _least_score(score_N: Array, right_N: Mask, wrong_images: int) -> float:
    """Halfway between the best wrong score beyond the share allowed and the next right score above it."""
    wrong = np.sort(score_N[~right_N])[::-1]
    allowed = int(FALSE_SHARE * wrong_images)
    highest = float(wrong[allowed]) if len(wrong) > allowed else 0.0
    above = score_N[right_N & (score_N > highest)]
    return 0.5 * (highest + (float(above.min()) if len(above) else 1.0))


def with_spread(calibration: PoseCalibration, right: Sequence[ReadImage]) -> PoseCalibration:
    """The calibration with the covariance and degrees of freedom under which errors are most likely."""
    read = [one for image in right if (one := _facing(image)) is not None]
    errors = np.array([error for _, error in read])
    stated = np.array([reading.covariance for reading, _ in read])
    poses = np.array([reading.T_r0_r1.as_array() for reading, _ in read])

    def changed(logs: Array) -> PoseCalibration:
        scale, along, across, floor_m, floor_rad, tails = np.exp(np.clip(logs, *_LIMITS.T)).tolist()
        return replace(
            calibration,
            scale=scale,
            along_share=along,
            across_share=across,
            floor_m=floor_m,
            floor_rad=floor_rad,
            degrees_of_freedom=2.0 + tails,
        )

    def cost(logs: Array) -> float:
        tried = changed(logs)
        tails = np.full(len(read), tried.degrees_of_freedom)
        return -float(log_density(errors, tried.covariances(stated, poses), tails).mean())

    options = {"xatol": 1e-3, "fatol": 1e-5, "maxiter": 4000, "maxfev": 4000}
    return changed(minimize(cost, np.log(_FIRST_SPREAD), method="Nelder-Mead", options=options).x)


def with_sharpness(calibration: PoseCalibration, right: Sequence[ReadImage]) -> PoseCalibration:
    """The calibration with the exponent of probabilities under which the true poses are most likely."""
    # Padded to (N, M): readings that an image lacks have no probability.
    evidence, densities = np.full((2, len(right), max(len(image.readings) for image in right)), -np.inf)
    for n, image in enumerate(right):
        evidence[n, : len(image.readings)] = [reading.log_evidence for reading in image.readings]
        densities[n, : len(image.readings)] = _log_densities(calibration, image)

    def likelihood(sharpness: float) -> float:
        log_masses = np.maximum(log_softmax(sharpness * evidence, axis=1), np.log(1e-12))
        logs = logsumexp(log_masses + densities, axis=1)
        return float(np.maximum(logs, LEAST_LOG_LIKELIHOOD).sum()) - 0.5 * np.log(sharpness) ** 2

    return replace(calibration, sharpness=max(SHARPNESSES, key=likelihood))


def _log_densities(calibration: PoseCalibration, image: ReadImage) -> Array:
    """(M,) log density of the truth under each reading."""
    covariances = [calibration.covariance(one.covariance, one.T_r0_r1) for one in image.readings]
    degrees = np.full(len(image.readings), calibration.degrees_of_freedom)
    return log_density(image.errors_M3(), np.array(covariances), degrees)


def _facing(image: ReadImage) -> tuple[Reading, Array] | None:
    """The reading that faces as the robot does, and its error (3,); None if there is none."""
    assert image.T_r0_r1 is not None
    errors = image.errors_M3()
    best = int(np.abs(errors[:, 2]).argmin())
    near = abs(errors[best, 2]) < SAME_READING_RAD and _is_at(image.readings[best], image.T_r0_r1)
    return (image.readings[best], errors[best]) if near else None


def _is_at(reading: Reading, T_r0_r1: SE2) -> bool:
    away_m = np.hypot(reading.T_r0_r1.x_m - T_r0_r1.x_m, reading.T_r0_r1.y_m - T_r0_r1.y_m)
    return bool(away_m < max(SAME_M, SAME_SHARE * np.hypot(T_r0_r1.x_m, T_r0_r1.y_m)))
