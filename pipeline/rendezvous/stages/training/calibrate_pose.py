"""Calibrate a trained relative-pose network on validation images; stored with the weights."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch
from rich.console import Console

from rendezvous.engine.progress import meter
from rendezvous.errors import ConfigError
from rendezvous.geometry.camera import Image
from rendezvous.geometry.cuboid import project_cuboid
from rendezvous.geometry.se2 import Array
from rendezvous.models.relative_pose_estimator import Detection, RelativePoseEstimator
from rendezvous.pose_estimation.covered import covered_image
from rendezvous.pose_estimation.observation_model import ObservationModel
from rendezvous.pose_estimation.pose_calibration import PoseCalibration
from rendezvous.pose_estimation.pose_calibration_fit import ReadImage, SeenPeaks, fitted, likeliest_noise
from rendezvous.stages.training.seen_images import SeenImage, digest_of_images, read_images
from rendezvous.stages.weights.trained_estimators import load_relative_pose
from rendezvous.store.disk import Disk
from rendezvous.store.read import StageReader
from rendezvous.training.checkpoint import read_checkpoint, with_record

IMAGES = 600  # enough, drawn at random from the validation split, to measure a coverage to within two points
LEAST_ROWS = 20  # fewest images in which the robot must be found
LEAST_VISIBILITY = 0.3
"""An image that shows the robot, but less of it, counts neither as with the robot nor as without."""
_SPLIT = "validation"


def calibrate_pose(
    weights: Path, dataset: str, *, seed: int, threads: int, count: int = IMAGES, console: Console
) -> PoseCalibration:
    """Write a calibration into the file of the network's weights; the weights themselves stay the same.

    Each image is read twice, as it is and with the robot painted over: images without a robot are few.

    Raises:
        StoreError: weights or dataset are missing or damaged.
        ConfigError: the weights are of another model, or the robot was found in too few images.
    """
    torch.set_num_threads(threads)
    disk = Disk(str(weights.parent))
    checkpoint = read_checkpoint(disk.read(weights.name), where=str(weights))
    # Without an earlier calibration.
    bare = with_record(checkpoint, calibration=PoseCalibration().as_dict())
    estimator = load_relative_pose(bare, where=str(weights))
    images = read_images(StageReader(dataset, "pack"), _SPLIT, count=count, seed=seed)
    calibration, found = _calibration(estimator, images, dataset, console)
    calibrated_on = {"images": len(images), "found": found, "data": digest_of_images(images)}
    disk.write(
        weights.name, with_record(checkpoint, calibration=calibration.as_dict(), calibrated_on=calibrated_on)
    )
    console.print(_summary(calibration, len(images), found), highlight=False)
    return calibration


def _calibration(
    estimator: RelativePoseEstimator, images: Sequence[SeenImage], dataset: str, console: Console
) -> tuple[PoseCalibration, int]:
    """The calibration, and the number of images in which the robot was found."""
    detections = list[tuple[SeenImage, ObservationModel, Detection, bool]]()
    empty = 0
    with meter("calibrate", total=len(images), console=console, parts="images", rows="images") as progress:
        for image in images:
            sighting = ObservationModel(camera=image.camera, T_r0_c=image.T_r0_c, robot=estimator.robot)
            for pixels, shown in _versions(image):
                detection = estimator.detection(pixels, sighting)
                if detection is None:
                    empty += 1
                else:
                    detections.append((image, sighting, detection, shown))
            progress.advance(1, made=True)
    seen = [
        SeenPeaks(look=detection.looks[0].look, peaks=detection.looks[0].peaks, uv_px=uv_px)
        for image, sighting, detection, shown in detections
        if shown and (uv_px := _true_points(image, sighting, detection)) is not None
    ]
    if len(seen) < LEAST_ROWS:
        raise ConfigError(
            f"{dataset}: the robot was found in {len(seen)} of {len(images)} {_SPLIT} images; a calibration "
            f"needs {LEAST_ROWS}: train longer, or on more images"
        )
    noise = likeliest_noise(seen, sigma_cells=estimator.close.sigma_cells)
    read = [
        ReadImage(
            readings=tuple(estimator.readings(detection.looks, sighting, noise)),
            T_r0_r1=image.truth.T_r0_r1 if shown else None,
        )
        for image, sighting, detection, shown in detections
    ]
    read += [ReadImage(readings=(), T_r0_r1=None)] * empty
    return fitted(noise, read), len(seen)


def _versions(image: SeenImage) -> list[tuple[Image, bool]]:
    """The images to read, each with whether it shows the robot."""
    pixels, truth = image.pixels(), image.truth
    if not truth.shows_robot:
        return [(pixels, False)]
    covered = [] if image.box_px is None else [(covered_image(pixels, image.box_px), False)]
    return [(pixels, True), *covered] if truth.visibility >= LEAST_VISIBILITY else covered


def _true_points(image: SeenImage, sighting: ObservationModel, detection: Detection) -> Array | None:
    """(9, 2) [px] the robot's true keypoints; None if the close look misses the robot."""
    assert image.T_c_o is not None
    uv_px = project_cuboid(image.T_c_o, sighting.robot.size_m, image.camera)
    look = detection.looks[0].look
    centre = look.to_input(uv_px[8])
    inside = (centre > 0.0).all() and (centre < [look.width_px, look.height_px]).all()
    return uv_px if inside and np.isfinite(uv_px).all() else None


def _summary(calibration: PoseCalibration, images: int, found: int) -> str:
    return (
        f"calibrate: on {images} validation images, the robot found in {found}: peaks to "
        f"{calibration.peak_floor_cells:.3f} cells; added {100.0 * calibration.along_share:.2f} % of the "
        f"distance along the sight, {100.0 * calibration.across_share:.2f} % across, "
        f"{1e3 * calibration.floor_m:.1f} mm, {np.degrees(calibration.floor_rad):.2f} deg; "
        f"{calibration.degrees_of_freedom:.1f} degrees of freedom; sharpness {calibration.sharpness:.2f}; "
        f"found from score {calibration.least_score:.3f} on"
    )
