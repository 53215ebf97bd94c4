"""Measure what an estimator of the relative pose reads from images."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import pandas as pd
from rich.console import Console

from rendezvous.commands.evaluate.measuring import Measurement, measured
from rendezvous.evaluation.relative_pose.errors import PoseOutcome, pose_table
from rendezvous.pose_estimation.covered import covered_image
from rendezvous.stages.training.seen_images import SeenImage, digest_of_images
from rendezvous.stages.weights.pose_source import PoseSource
from rendezvous.store.disk import Disk

CACHE = "relative_pose"


@dataclass(frozen=True, slots=True, kw_only=True)
class PoseVariant:
    """An estimator's source, and whether it takes the robots to stand on one floor."""

    source: PoseSource
    floor: bool

    @property
    def name(self) -> str:
        """Its name in tables and files."""
        return "floor" if self.floor else "free"


def measured_poses(
    variant: PoseVariant, images: Sequence[SeenImage], *, folder: Path, workers: int, console: Console
) -> tuple[pd.DataFrame, tuple[PoseOutcome, ...]]:
    """The table of `pose_table` and its outcomes, from the cache if nothing they depend on has changed.

    Args:
        variant: of the estimator.
        images: at least one.
        folder: the report's.
        workers: processes; with a single one, this one.
        console: for messages.
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
        },
    )
    cache = Disk(str(folder / CACHE))
    rows = measured(measurement, images, cache=cache, workers=workers, console=console)
    return pose_table([image.truth for image in images], rows), rows


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
