"""Measure the estimator of the relative pose on published images, and write its part of the report."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from rich.console import Console

from rendezvous.commands.evaluate.measured_poses import PoseVariant, measured_poses
from rendezvous.commands.evaluate.recorded import RecordFolder
from rendezvous.commands.evaluate.report_folder import PAGE, keep_evaluation, kept_metrics
from rendezvous.errors import ConfigError, StoreError
from rendezvous.evaluation.relative_pose.errors import PoseOutcome
from rendezvous.evaluation.relative_pose.gallery import PoseShown, chosen_images, pose_shown
from rendezvous.evaluation.relative_pose.report import VARIANTS, FloorGain, PoseContent, pose_part
from rendezvous.evaluation.relative_pose.summary import PoseSummary, pose_summary
from rendezvous.evaluation.report.recorded_figures import ImageConditions, RecordedFigures
from rendezvous.evaluation.statistics import bootstrap_mean, resample_weights
from rendezvous.resources import METRICS
from rendezvous.seeds import stream
from rendezvous.stages.training.seen_images import KINDS, SeenImage, digest_of_images, read_images
from rendezvous.stages.weights.estimators import plans_trained_on, trained_on
from rendezvous.stages.weights.pose_source import PoseSource, PoseWeights, require_known_robot
from rendezvous.stages.weights.provenance import commit, hardware, versions
from rendezvous.store.disk import Disk
from rendezvous.store.read import StageReader
from rendezvous.training.frame_error.pairs import SPLIT_NAMES

POSE_RECORDS = METRICS / "relative_pose"
_PACKAGES = ("rendezvous-fusion", "numpy", "scipy", "opencv-python-headless", "numba", "torch", "pyarrow")


@dataclass(frozen=True, slots=True, kw_only=True)
class PoseEvaluation:
    """What to measure.

    Attributes:
        dataset: folder that `pack` wrote.
        split: its split.
        count: largest number of images, drawn at random; None for all.
        kinds: of `seen_images.KINDS`.
        weights: of the estimator, or None for those in `runs/`, then the shipped ones.
        floor: whether the estimator takes the floor as known; None for both, side by side.
        seed: of the draw of images.
        folder: the report's.
        workers: number of processes.
        records: folder of recorded figures.
        record: whether to record this run's figures there.
        unseen: whether to leave out floor plans that the weights were trained on.
        source: what makes the estimator, instead of weights.
        console: for messages.
    """

    dataset: str = "data/dataset"
    split: str = "test"
    count: int | None = 1000
    kinds: tuple[str, ...] = KINDS
    weights: Path | None = None
    floor: bool | None = None
    seed: int = 0
    folder: Path = Path("report")
    workers: int = 1
    records: Path = POSE_RECORDS
    record: bool = False
    unseen: bool = False
    source: PoseSource | None = None
    console: Console = field(default_factory=lambda: Console(stderr=True))


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


def require_split(split: str) -> None:
    """Check that there is such a split.

    Raises:
        ConfigError: there is none.
    """
    if split not in SPLIT_NAMES:
        raise ConfigError(f"--split is {split!r}; must be one of {', '.join(SPLIT_NAMES)}")


def require_robot_of_images(images: Sequence[SeenImage], source: PoseSource, dataset: str) -> None:
    """Check that images show the robot that the weights know.

    Raises:
        ConfigError: they show another one.
    """
    record = source.record()
    for image in images:
        require_known_robot(
            record,
            image.cuboid_size_m,
            image.T_r1_o,
            weights="the weights",
            whose=f"{dataset}, in {image.truth.image_id},",
            instead="other --weights",
        )


def unseen_images(
    images: Sequence[SeenImage], records: Sequence[Mapping[str, Any]], console: Console
) -> list[SeenImage]:
    """The images of floor plans that no weights were trained on.

    Args:
        images: of all plans.
        records: of the training of each of the weights.
        console: for the number of images left out.

    Raises:
        StoreError: there are no such images.
    """
    unseen = [i for i in images if not any(trained_on(record, i.plan_digest) for record in records)]
    if not unseen:
        raise StoreError(f"the weights were trained on the floor plans of all {len(images)} images")
    console.print(
        f"evaluate: left out {len(images) - len(unseen)} of {len(images)} images, of floor plans that the "
        "weights were trained on",
        highlight=False,
        soft_wrap=True,
    )
    return unseen


def image_conditions(
    images: Sequence[SeenImage],
    split: str,
    seed: int,
    sources: Mapping[str, PoseSource],
    console: Console,
) -> ImageConditions:
    """The conditions of measuring images; warns if the weights were trained on their floor plans."""
    plans = {image.truth.plan_id: image.plan_digest for image in images}
    known = {name: _known_plans(source, plans) for name, source in sources.items()}
    for name, count in known.items():
        if count:
            console.print(
                f"evaluate {name}: warning: trained on {count} of these {len(plans)} floor plans; its errors "
                "on plans that it never saw may be larger than these",
                highlight=False,
                soft_wrap=True,
            )
    return ImageConditions(
        split=split,
        images=len(images),
        plans=len(plans),
        data_digest=digest_of_images(images),
        seed=seed,
        weights={name: source.digest for name, source in sources.items()},
        trained_on=known,
        commit=commit(),
        hardware=hardware(),
    )


def _known_plans(source: PoseSource, plans: Mapping[str, str]) -> int | None:
    record = source.record()
    return plans_trained_on(record, plans) if "data" in record else None


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
