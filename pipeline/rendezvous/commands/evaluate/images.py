"""What evaluations on images share: settings, checks of their images, conditions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rich.console import Console

from rendezvous.commands.evaluate.measuring import EvaluationSettings
from rendezvous.errors import StoreError
from rendezvous.evaluation.report.recorded_figures import ImageConditions
from rendezvous.stages.training.seen_images import SeenImage, digest_of_images
from rendezvous.stages.weights.estimators import plans_trained_on, trained_on
from rendezvous.stages.weights.pose_source import PoseSource, require_known_robot
from rendezvous.stages.weights.provenance import commit, hardware


@dataclass(frozen=True, slots=True, kw_only=True)
class ImageEvaluation(EvaluationSettings):
    """What to measure on images."""

    weights: Path | None = None  # of the relative pose, or None for those in `runs/`, then the shipped ones
    records: Path  # folder of recorded figures
    record: bool = False  # whether to record this run's figures there
    unseen: bool = False  # whether to leave out floor plans that the weights were trained on
    source: PoseSource | None = None  # what makes the estimator of the relative pose, instead of weights


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
    images: Sequence[SeenImage], source: PoseSource, settings: ImageEvaluation
) -> ImageConditions:
    """The conditions of measuring images; warns if the weights were trained on their floor plans."""
    plans = {image.truth.plan_id: image.plan_digest for image in images}
    record = source.record()
    known = plans_trained_on(record, plans) if "data" in record else None
    settings.warn_of_known_plans("relative pose", known, len(plans))
    return ImageConditions(
        split=settings.split,
        images=len(images),
        plans=len(plans),
        data_digest=digest_of_images(images),
        seed=settings.seed,
        weights={"relative pose": source.digest},
        trained_on={"relative pose": known},
        commit=commit(),
        hardware=hardware(),
    )
