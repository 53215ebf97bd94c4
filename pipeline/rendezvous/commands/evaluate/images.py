"""What evaluations on images share: settings, checks of their images, conditions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from rich.console import Console

from rendezvous.errors import ConfigError, StoreError
from rendezvous.evaluation.report.recorded_figures import ImageConditions
from rendezvous.stages.training.seen_images import SeenImage, digest_of_images
from rendezvous.stages.weights.estimators import plans_trained_on, trained_on
from rendezvous.stages.weights.pose_source import PoseSource, require_known_robot
from rendezvous.stages.weights.provenance import commit, hardware
from rendezvous.training.frame_error.pairs import SPLIT_NAMES


@dataclass(frozen=True, slots=True, kw_only=True)
class ImageEvaluation:
    """What to measure on images.

    Attributes:
        dataset: folder that `pack` wrote.
        split: its split.
        weights: of the relative pose, or None for those in `runs/`, then the shipped ones.
        seed: of the draw of images.
        folder: the report's.
        workers: number of processes.
        records: folder of recorded figures.
        record: whether to record this run's figures there.
        unseen: whether to leave out floor plans that the weights were trained on.
        source: what makes the estimator of the relative pose, instead of weights.
        console: for messages.
    """

    dataset: str = "data/dataset"
    split: str = "test"
    weights: Path | None = None
    seed: int = 0
    folder: Path = Path("report")
    workers: int = 1
    records: Path
    record: bool = False
    unseen: bool = False
    source: PoseSource | None = None
    console: Console = field(default_factory=lambda: Console(stderr=True))


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
