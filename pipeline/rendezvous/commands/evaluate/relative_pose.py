"""Measure the estimator of the relative pose on published images, and write its part of the report."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from rendezvous.commands.evaluate.images import (
    ImageEvaluation,
    image_conditions,
    require_robot_of_images,
    require_split,
    unseen_images,
)
from rendezvous.commands.evaluate.measured_poses import PoseVariant, measured_poses
from rendezvous.commands.evaluate.recorded import RecordFolder
from rendezvous.commands.evaluate.report_folder import PAGE, keep_evaluation, kept_metrics
from rendezvous.errors import ConfigError
from rendezvous.evaluation.relative_pose.errors import PoseOutcome
from rendezvous.evaluation.relative_pose.gallery import PoseShown, chosen_images, pose_shown
from rendezvous.evaluation.relative_pose.report import VARIANTS, FloorGain, PoseContent, pose_part
from rendezvous.evaluation.relative_pose.summary import PoseSummary, pose_summary
from rendezvous.evaluation.report.recorded_figures import ImageConditions, RecordedFigures
from rendezvous.evaluation.statistics import bootstrap_mean, resample_weights
from rendezvous.resources import METRICS
from rendezvous.seeds import stream
from rendezvous.stages.training.seen_images import KINDS, SeenImage, read_images
from rendezvous.stages.weights.pose_source import PoseWeights
from rendezvous.stages.weights.provenance import versions
from rendezvous.store.disk import Disk
from rendezvous.store.read import StageReader

POSE_RECORDS = METRICS / "relative_pose"
_PACKAGES = ("rendezvous-fusion", "numpy", "scipy", "opencv-python-headless", "numba", "torch", "pyarrow")


@dataclass(frozen=True, slots=True, kw_only=True)
class PoseEvaluation(ImageEvaluation):
    """What to measure.

    Attributes:
        count: largest number of images, drawn at random; None for all.
        kinds: of `seen_images.KINDS`.
        floor: whether the estimator takes the floor as known; None for both, side by side.
    """

    count: int | None = 1000
    kinds: tuple[str, ...] = KINDS
    floor: bool | None = None
    records: Path = POSE_RECORDS


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
    conditions = image_conditions(
        images, settings.split, settings.seed, {"relative pose": source}, settings.console
    )
    recorded = RecordFolder.read(settings.records, RecordedFigures[PoseSummary], command="evaluate-pose")
    if settings.record:
        recorded.require_no_loss([variant.name for variant in variants], conditions)
    measured = {
        variant.name: measured_poses(
            variant, images, folder=settings.folder, workers=settings.workers, console=settings.console
        )
        for variant in variants
    }
    content = _content(images, conditions, measured, recorded, settings)
    if settings.record:
        recorded.keep((content.rows[name] for name in measured), settings.console)
    keep_evaluation(disk, pose_part(content), _metrics(content), settings.console)
    return settings.folder / PAGE


def _images(settings: PoseEvaluation) -> list[SeenImage]:
    require_split(settings.split)
    if not settings.kinds:
        raise ConfigError(f"--images names nothing; must name {' or '.join(KINDS)}, or both")
    for kind in settings.kinds:
        if kind not in KINDS:
            raise ConfigError(f"--images names {kind!r}; must be of {', '.join(KINDS)}")
    reader = StageReader(settings.dataset, "pack")
    return read_images(reader, settings.split, kinds=settings.kinds, count=settings.count, seed=settings.seed)


def _metrics(content: PoseContent) -> dict[str, Any]:
    """The entry in `metrics.json`."""
    return {
        "conditions": asdict(content.conditions),
        "variants": {
            name: {**row.to_json(), "source": "measured" if name in content.found else "recorded"}
            for name, row in content.rows.items()
        },
        "floor_gain": content.gain and asdict(content.gain),
    }


def _content(
    images: Sequence[SeenImage],
    conditions: ImageConditions,
    measured: Mapping[str, tuple[pd.DataFrame, Sequence[PoseOutcome]]],
    recorded: RecordFolder[RecordedFigures[PoseSummary]],
    settings: PoseEvaluation,
) -> PoseContent:
    found = {name: table for name, (table, _) in measured.items()}
    rows = recorded.of_split(settings.split) | {
        name: RecordedFigures(name=name, conditions=conditions, figures=pose_summary(table))
        for name, table in found.items()
    }
    return PoseContent(
        conditions=conditions,
        found=found,
        rows={name: rows[name] for name in VARIANTS if name in rows},
        gain=_floor_gain(found, settings.seed),
        gallery=_gallery(images, *next(iter(measured.values()))),
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
    return [
        pose_shown(
            why,
            table.loc[number],
            outcomes[number],
            encoded=images[number].encoded,
            camera=images[number].camera,
            cuboid_size_m=images[number].cuboid_size_m,
            box_px=images[number].box_px,
        )
        for why, number in chosen_images(table)
    ]
