"""Fits a `PoseCalibration` to images whose truth is known.

First the noise of peaks, then, with poses read under it, the score of detection, the spread of poses and the
sharpness of their probabilities: each by likelihood of the truth.

Legend: N images.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import minimize
from scipy.special import expit, logsumexp

from rendezvous.alignment.spread import log_density
from rendezvous.geometry.occupancy_grid import Mask
from rendezvous.geometry.se2 import SE2, Array
from rendezvous.pose_estimation.cuboid_pose import Reading
from rendezvous.pose_estimation.keypoint_evidence import KeypointNoise, evidence_of
from rendezvous.pose_estimation.look import Look
from rendezvous.pose_estimation.peaks import Peaks
from rendezvous.pose_estimation.pose_calibration import PoseCalibration, score_features

SAME_M, SAME_SHARE = 0.3, 0.15
"""A reading is of the robot itself if it is no farther from it than one of these, the latter of the
distance."""
SAME_READING_RAD = 0.25 * np.pi
"""A reading whose heading is wrong by more took one side of the robot for another."""
FALSE_SHARE = 0.005
"""Of images without the robot, in which one may be found: half of what is called for, for few tell it."""
SHARPNESSES = tuple(float(s) for s in np.geomspace(0.01, 100.0, 49))
"""What is tried, around 1. Where few images have several readings, the nearer to 1 the better: the log of it
is normal to begin with, one standard deviation being a factor of e."""
_FIRST_SPREAD = (1.0, 0.02, 0.005, 0.003, 0.01, 3.0)
"""Scale, shares along and across, floor of x and y [m], of yaw [rad], degrees of freedom above 2."""
_LIMITS = np.log([(0.05, 50.0), (1e-4, 0.5), (1e-4, 0.5), (1e-4, 0.3), (1e-4, 1.0), (0.1, 1e3)])
_NOISE_LIMITS = np.log([(0.01, 3.0), (0.001, 30.0)])
_RIDGE = 1e-3


@dataclass(frozen=True, slots=True, kw_only=True)
class SeenPeaks:
    """A close look at the robot.

    Attributes:
        look: the part of the image.
        peaks: that were found there.
        uv_px: (9, 2) where the points truly are in the image.
    """

    look: Look
    peaks: Peaks
    uv_px: Array


@dataclass(frozen=True, slots=True, kw_only=True)
class ReadImage:
    """What was read in an image.

    Attributes:
        readings: the most probable first; none if nothing looked like the robot.
        T_r0_r1: the true pose; None without a robot.
    """

    readings: tuple[Reading, ...]
    T_r0_r1: SE2 | None

    @property
    def right(self) -> bool:
        """Whether the best reading is of the robot itself, whichever way it faces."""
        return bool(self.readings) and self.T_r0_r1 is not None and _of_it(self.readings[0], self.T_r0_r1)


def likeliest_noise(seen: Sequence[SeenPeaks], *, sigma_cells: float) -> KeypointNoise:
    """The noise of peaks under which the true points are most likely."""

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
    """The calibration that fits best.

    Args:
        noise: of the peaks, under which the images were read.
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
    """The logistic regression of what is right, and the score that few images without the robot reach."""
    read = [image for image in images if image.readings]
    features = np.array([[1.0, *score_features(image.readings[0])] for image in read])
    right = np.array([image.right for image in read])

    def cost(weights: Array) -> float:
        margin = np.where(right, 1.0, -1.0) * (features @ weights)
        return float(np.logaddexp(0.0, -margin).mean() + _RIDGE * (weights[1:] ** 2).mean())

    # More that agrees must never tell against a robot, however few images say so.
    bounds = [(None, None)] + [(0.0, None)] * (features.shape[1] - 1)
    weights = minimize(cost, np.zeros(features.shape[1]), method="L-BFGS-B", bounds=bounds).x
    least = _least_score(expit(features @ weights), right, len(images) - sum(i.right for i in images))
    bias, of_explained, of_gain = (float(w) for w in weights)
    return replace(calibration, bias=bias, of_explained=of_explained, of_gain=of_gain, least_score=least)


def _least_score(score_N: Array, right_N: Mask, wrong_images: int) -> float:
    """Halfway between the best score that is wrong, but for as many as may be, and the next that is right."""
    wrong = np.sort(score_N[~right_N])[::-1]
    allowed = int(FALSE_SHARE * wrong_images)
    highest = float(wrong[allowed]) if len(wrong) > allowed else 0.0
    above = score_N[right_N & (score_N > highest)]
    return 0.5 * (highest + (float(above.min()) if len(above) else 1.0))


def with_spread(calibration: PoseCalibration, right: Sequence[ReadImage]) -> PoseCalibration:
    """The covariance and the degrees of freedom under which errors are most likely."""
    read = [one for image in right if (one := _nearest(image)) is not None]
    errors = np.array([error for _, error in read])
    told = np.array([reading.covariance for reading, _ in read])
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
        return -float(log_density(errors, tried.covariances(told, poses), tails).mean())

    options = {"xatol": 1e-3, "fatol": 1e-5, "maxiter": 4000, "maxfev": 4000}
    return changed(minimize(cost, np.log(_FIRST_SPREAD), method="Nelder-Mead", options=options).x)


def with_sharpness(calibration: PoseCalibration, right: Sequence[ReadImage]) -> PoseCalibration:
    """The exponent of the readings' probabilities under which the true poses are most likely."""
    densities = [_log_densities(calibration, image) for image in right]

    def likelihood(sharpness: float) -> float:
        tried = replace(calibration, sharpness=sharpness)
        logs = [
            logsumexp(np.log(np.maximum(tried.masses([r.log_evidence for r in image.readings]), 1e-12)) + d)
            for image, d in zip(right, densities, strict=True)
        ]
        # An image whose truth none of its readings holds says nothing of which to believe.
        return float(np.maximum(logs, -20.0).sum()) - 0.5 * np.log(sharpness) ** 2

    return replace(calibration, sharpness=max(SHARPNESSES, key=likelihood))


def _log_densities(calibration: PoseCalibration, image: ReadImage) -> Array:
    """(M,) of the truth under each reading."""
    assert image.T_r0_r1 is not None
    readings = image.readings
    return log_density(
        np.array([_error(reading, image.T_r0_r1) for reading in readings]),
        np.array([calibration.covariance(reading.covariance, reading.T_r0_r1) for reading in readings]),
        np.full(len(readings), calibration.degrees_of_freedom),
    )


def _nearest(image: ReadImage) -> tuple[Reading, Array] | None:
    """The reading that faces as the robot does, and its error; None if there is none."""
    assert image.T_r0_r1 is not None
    errors = [_error(reading, image.T_r0_r1) for reading in image.readings]
    best = min(range(len(errors)), key=lambda m: abs(errors[m][2]))
    near = abs(errors[best][2]) < SAME_READING_RAD and _of_it(image.readings[best], image.T_r0_r1)
    return (image.readings[best], errors[best]) if near else None


def _error(reading: Reading, T_r0_r1: SE2) -> Array:
    return (reading.T_r0_r1.inverse() @ T_r0_r1).wrapped().as_array()


def _of_it(reading: Reading, T_r0_r1: SE2) -> bool:
    away_m = np.hypot(reading.T_r0_r1.x_m - T_r0_r1.x_m, reading.T_r0_r1.y_m - T_r0_r1.y_m)
    return bool(away_m < max(SAME_M, SAME_SHARE * np.hypot(T_r0_r1.x_m, T_r0_r1.y_m)))
