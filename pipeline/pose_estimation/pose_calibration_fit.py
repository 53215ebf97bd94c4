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
from scipy.stats import chi2

from pipeline.geometry.occupancy_grid import Mask
from pipeline.geometry.se2 import SE2, Array
from pipeline.pose_estimation.cuboid_pose import Reading
from pipeline.pose_estimation.keypoint_evidence import KeypointNoise, evidence_of
from pipeline.pose_estimation.look import Look
from pipeline.pose_estimation.peaks import Peaks
from pipeline.pose_estimation.pose_calibration import PoseCalibration, score_features

SAME_M, SAME_SHARE = 0.3, 0.15
"""A reading is of the robot itself if it is no farther from it than one of these, the latter of the
distance."""
SAME_READING_RAD = 0.25 * np.pi
"""A reading whose heading is wrong by more took one side of the robot for another."""
FALSE_SHARE = 0.005
"""Of images without the robot, in which one may be found: half of what is called for, for few tell it."""
SHARPNESSES = tuple(float(s) for s in np.geomspace(0.02, 2.0, 25))
_TAILS = 6.0
"""Degrees of freedom of the t distribution that spreads are fitted with, so that a few bad poses count
little."""
_LEVELS = (0.5, 0.9, 0.95)
_FIRST_SPREAD = (1.0, 0.02, 0.005, 0.003, 0.01)
_LIMITS = np.log([(0.05, 50.0), (1e-4, 0.5), (1e-4, 0.5), (1e-4, 0.3), (1e-4, 1.0)])
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
    """The covariance under which errors are most likely, scaled so that ellipsoids hold as many as they
    should."""
    read = [one for image in right if (one := _nearest(image)) is not None]
    errors = np.array([error for _, error in read])

    def changed(logs: Array) -> PoseCalibration:
        scale, along, across, floor_m, floor_rad = np.exp(np.clip(logs, *_LIMITS.T)).tolist()
        return replace(
            calibration,
            scale=scale,
            along_share=along,
            across_share=across,
            floor_m=floor_m,
            floor_rad=floor_rad,
        )

    def nees(found: PoseCalibration) -> tuple[Array, Array]:
        covariances = np.array([found.covariance(r.covariance, r.T_r0_r1) for r, _ in read])
        solved = np.linalg.solve(covariances, errors[..., None])[..., 0]
        return (errors * solved).sum(axis=1), np.linalg.slogdet(covariances)[1]

    def cost(logs: Array) -> float:
        distance, log_det = nees(changed(logs))
        return float((0.5 * log_det + 0.5 * (_TAILS + 3.0) * np.log1p(distance / _TAILS)).mean())

    best = minimize(
        cost, np.log(_FIRST_SPREAD), method="Nelder-Mead", options={"maxiter": 2000, "fatol": 1e-4}
    )
    found = changed(best.x)
    ratios = np.quantile(nees(found)[0], _LEVELS) / chi2.ppf(_LEVELS, 3)
    wider = float(np.exp(np.log(ratios).mean()))
    return replace(
        found,
        scale=wider * found.scale,
        **{
            name: float(np.sqrt(wider)) * getattr(found, name)
            for name in ("along_share", "across_share", "floor_m", "floor_rad")
        },
    )


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
        return float(np.maximum(logs, -20.0).mean())

    return replace(calibration, sharpness=max(SHARPNESSES, key=likelihood))


def _log_densities(calibration: PoseCalibration, image: ReadImage) -> Array:
    """(M,) of the truth under each reading, up to a constant."""
    assert image.T_r0_r1 is not None
    out = []
    for reading in image.readings:
        error = _error(reading, image.T_r0_r1)
        covariance = calibration.covariance(reading.covariance, reading.T_r0_r1)
        out.append(-0.5 * (error @ np.linalg.solve(covariance, error) + np.linalg.slogdet(covariance)[1]))
    return np.array(out)


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
