"""Measure the estimator of the relative pose on published images, and write its part of the report."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from rendezvous.commands.evaluate.images import (
    ImageEvaluation,
    image_conditions,
    require_robot_of_images,
    unseen_images,
)
from rendezvous.commands.evaluate.kept import PAGE, RecordFolder, keep_evaluation, kept_metrics, with_sources
from rendezvous.commands.evaluate.measuring import Measurement, measured
from rendezvous.errors import ConfigError
from rendezvous.evaluation.pictures.poses import labelled_image
from rendezvous.evaluation.relative_pose.errors import PoseOutcome, pose_table
from rendezvous.evaluation.relative_pose.gallery import IMAGE_PX, PoseShown, chosen_images
from rendezvous.evaluation.relative_pose.report import VARIANTS, FloorGain, PoseContent, pose_part
from rendezvous.evaluation.relative_pose.summary import PoseSummary, pose_summary
from rendezvous.evaluation.report.recorded_figures import ImageConditions, RecordedFigures
from rendezvous.evaluation.statistics import bootstrap_mean, resample_weights
from rendezvous.geometry.cuboid import project_cuboid
from rendezvous.pose_estimation.covered import covered_image
from rendezvous.resources import METRICS
from rendezvous.seeds import stream
from rendezvous.stages.training.seen_images import KINDS, SeenImage, digest_of_images, read_images
from rendezvous.stages.weights.pose_source import PoseSource, PoseWeights
from rendezvous.stages.weights.provenance import versions
from rendezvous.store.disk import Disk
from rendezvous.store.read import StageReader

POSE_RECORDS = METRICS / "relative_pose"
_PACKAGES = ("rendezvous-fusion", "numpy", "scipy", "opencv-python-headless", "numba", "torch", "pyarrow")


@dataclass(frozen=True, slots=True, kw_only=True)
class PoseEvaluation(ImageEvaluation):
    """What to measure."""

    count: int | None = 1000  # largest number of images, drawn at random; None for all
    kinds: tuple[str, ...] = KINDS  # of `seen_images.KINDS`
    floor: bool | None = None  # whether the estimator takes the floor as known; None for both, side by side
    records: Path = POSE_RECORDS


@dataclass(frozen=True, slots=True, kw_only=True)
class PoseVariant:
    """An estimator's source, and whether it takes the robots to stand on one floor."""

    source: PoseSource
    floor: bool

    @property
    def name(self) -> str:
        """Its name in tables and files."""
        return "floor" if self.floor else "free"


def evaluate_pose(settings: PoseEvaluation) -> Path:
    """Measure, record if asked to, and write the report.

    Returns:
        Path of the page.

    Raises:
        StoreError: the dataset, its images, the weights or recorded figures are missing or damaged, or
            nothing can be written.
        ConfigError: there is no such split or kind of images, the weights do not know the images' robot, or
            recorded figures are of more images.
        SetupError: a package is missing.
    """
    images = _images(settings)
    # Whatever is wrong with files shows here, not after an hour of measuring.
    disk = Disk(str(settings.folder))
    kept_metrics(disk)
    source = settings.source or PoseWeights.found(settings.weights)
    floors = (True, False) if settings.floor is None else (settings.floor,)
    variants = [PoseVariant(source=source, floor=floor) for floor in floors]
    variants[0].source.estimator(floor=variants[0].floor)
    require_robot_of_images(images, source, settings.dataset)
    if settings.unseen:
        images = unseen_images(images, [source.record()], settings.console)
    conditions = image_conditions(images, source, settings)
    recorded = RecordFolder.read(settings.records, RecordedFigures[PoseSummary], command="evaluate-pose")
    if settings.record:
        recorded.require_no_loss([variant.name for variant in variants], conditions)
    found = {variant.name: measured_poses(variant, images, settings) for variant in variants}
    content = _content(images, conditions, found, recorded, settings)
    if settings.record:
        recorded.keep((content.rows[name] for name in found), settings.console)
    keep_evaluation(disk, pose_part(content), _metrics(content), settings.console)
    return settings.folder / PAGE


def _images(settings: PoseEvaluation) -> list[SeenImage]:
    settings.require_split()
    if not settings.kinds:
        raise ConfigError(f"--images names nothing; must name {' or '.join(KINDS)}, or both")
    for kind in settings.kinds:
        if kind not in KINDS:
            raise ConfigError(f"--images names {kind!r}; must be of {', '.join(KINDS)}")
    reader = StageReader(settings.dataset, "pack")
    return read_images(reader, settings.split, kinds=settings.kinds, count=settings.count, seed=settings.seed)


def measured_poses(
    variant: PoseVariant, images: Sequence[SeenImage], settings: PoseEvaluation
) -> tuple[pd.DataFrame, tuple[PoseOutcome, ...]]:
    """The table of `pose_table` and its outcomes, from the cache if nothing they depend on has changed."""
    measurement = Measurement(
        command="evaluate-pose",
        cache="relative_pose",
        name=variant.name,
        items_name="images",
        measure=partial(_measure, variant),
        outcome=PoseOutcome,
        key={
            "weights": variant.source.digest,
            "floor": variant.floor,
            "images": digest_of_images(images),
        },
    )
    rows = measured(measurement, images, settings)
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


def _metrics(content: PoseContent) -> dict[str, Any]:
    """The entry in `metrics.json`."""
    return {
        "conditions": asdict(content.conditions),
        "variants": with_sources(content.rows, content.found),
        "floor_gain": content.gain and asdict(content.gain),
    }


def _content(
    images: Sequence[SeenImage],
    conditions: ImageConditions,
    outcomes: Mapping[str, tuple[pd.DataFrame, Sequence[PoseOutcome]]],
    recorded: RecordFolder[RecordedFigures[PoseSummary]],
    settings: PoseEvaluation,
) -> PoseContent:
    found = {name: table for name, (table, _) in outcomes.items()}
    rows = recorded.of_split(settings.split) | {
        name: RecordedFigures(name=name, conditions=conditions, figures=pose_summary(table))
        for name, table in found.items()
    }
    return PoseContent(
        conditions=conditions,
        found=found,
        rows={name: rows[name] for name in VARIANTS if name in rows},
        gain=_floor_gain(found, settings.seed),
        gallery=_gallery(images, *next(iter(outcomes.values()))),
        dataset=settings.dataset,
        versions=versions(_PACKAGES),
    )


def _floor_gain(found: Mapping[str, pd.DataFrame], seed: int) -> FloorGain | None:
    """What the floor changes where both variants found the robot; None without both."""
    if len(found) < 2:
        return None
    floor, free = found["floor"], found["free"]
    both = floor.detected & free.detected
    if not both.any():
        return None
    _, plan = np.unique(floor.plan_id, return_inverse=True)
    weights = resample_weights(plan, rng=stream(seed, "evaluation", "bootstrap"))[:, both]
    return FloorGain(
        images=int(both.sum()),
        position_m=bootstrap_mean((floor.position_m - free.position_m)[both].to_numpy(), weights),
        heading_rad=bootstrap_mean((floor.turn_rad - free.turn_rad)[both].to_numpy(), weights),
    )


def _gallery(
    images: Sequence[SeenImage], table: pd.DataFrame, outcomes: Sequence[PoseOutcome]
) -> list[PoseShown]:
    shown = []
    for why, number in chosen_images(table):
        image, T_c_o = images[number], outcomes[number].T_c_o
        read = None if T_c_o is None else project_cuboid(T_c_o, image.cuboid_size_m, image.camera)
        drawn = {
            "image": image.encoded,
            "projected_cuboid_px": read,
            "box_px": image.box_px,
            "pose_id": image.truth.image_id,
        }
        picture = labelled_image(drawn, width_px=IMAGE_PX)
        shown.append(PoseShown(why=why, row=table.loc[number], image=picture))
    return shown
