"""What an estimator of the relative pose reads from images."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from rich.console import Console

from rendezvous.commands.evaluate.measuring import Measurement, code_digest, measured
from rendezvous.evaluation.relative_pose.errors import PoseOutcome, PoseOutcomes
from rendezvous.pose_estimation.covered import covered_image
from rendezvous.stages.training.seen_images import SeenImage, digest_of_images
from rendezvous.stages.weights.pose_source import PoseSource
from rendezvous.stages.weights.provenance import versions
from rendezvous.store.disk import Disk

CACHE = "relative_pose"
POSE_CODE = ("geometry", "models", "pose_estimation")
POSE_PACKAGES = ("numpy", "scipy", "opencv-python-headless", "numba", "torch")
"""What poses depend on, beside the weights."""
_FILES = (
    "evaluation/relative_pose/errors.py",
    "commands/evaluate/measured_poses.py",
    "stages/weights/pose_source.py",
    "stages/weights/pose_weights.py",
    "stages/training/seen_images.py",
)


@dataclass(frozen=True, slots=True, kw_only=True)
class PoseVariant:
    """An estimator as it is measured: its source, and whether the robot stands on the camera's floor."""

    source: PoseSource
    floor: bool

    @property
    def name(self) -> str:
        """What tables call it."""
        return "floor" if self.floor else "free"


def measured_poses(
    variant: PoseVariant, images: Sequence[SeenImage], *, folder: Path, workers: int, console: Console
) -> PoseOutcomes:
    """What becomes of each image; from the cache, if nothing that it depends on has changed.

    Args:
        variant: of the estimator.
        images: at least one.
        folder: of the report.
        workers: processes; a single one is this one.
        console: where to tell.
    """
    measurement = Measurement(
        command="evaluate-pose",
        name=variant.name,
        items_name="images",
        measure=partial(_measure, variant),
        from_json=PoseOutcome.from_json,
        key={
            "weights": variant.source.digest,
            "floor": variant.floor,
            "images": digest_of_images(images),
            "code": code_digest(POSE_CODE, _FILES),
            "packages": versions(POSE_PACKAGES),
        },
    )
    cache = Disk(str(folder / CACHE))
    rows = measured(measurement, images, cache=cache, workers=workers, console=console)
    return PoseOutcomes(tuple(image.truth for image in images), rows)


def _measure(variant: PoseVariant, images: Sequence[SeenImage]) -> list[PoseOutcome]:
    estimator = variant.source.estimator(floor=variant.floor)
    # Once untimed: compiled code is loaded at the first call.
    estimator(images[0].pixels(), images[0].camera, images[0].T_r0_c)
    outcomes = []
    for image in images:
        pixels = image.pixels()
        started_s = time.perf_counter()
        pose = estimator(pixels, image.camera, image.T_r0_c)
        duration_s = time.perf_counter() - started_s
        covered = None
        if image.box_px is not None:
            covered = estimator(covered_image(pixels, image.box_px), image.camera, image.T_r0_c).found
        outcomes.append(
            PoseOutcome.of(image.truth.image_id, pose, duration_s=duration_s, found_covered=covered)
        )
    return outcomes
