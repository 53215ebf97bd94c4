"""Commands that measure: the relative pose on images, the frame error on maps, and both together."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from rendezvous.cli.options import CORES, Data, Workers, dataset_folder
from rendezvous.errors import ConfigError, needs_extra
from rendezvous.resources import IN_CHECKOUT

Split = Annotated[str, typer.Option("--split", help="train, validation or test.")]
Count = Annotated[int | None, typer.Option("--count", min=1, help="At most this many; all by default.")]
Report = Annotated[Path, typer.Option("--report", help="Folder of index.html, metrics.json.")]
Record = Annotated[bool, typer.Option("--record", help="Keep the figures for later reports, in --records.")]
Records = Annotated[
    Path | None, typer.Option("--records", help="Folder of kept figures; in assets/metrics by default.")
]
Unseen = Annotated[
    bool, typer.Option("--unseen", help="Leave out floor plans that the weights were trained on.")
]
PoseWeightsPath = Annotated[
    Path | None,
    typer.Option(
        "--weights", help="Relative-pose weights; those in runs/relative-pose, or else the shipped ones."
    ),
]


def evaluate_pose(
    data: Data = "data",
    split: Split = "test",
    count: Annotated[
        int | None, typer.Option("--count", min=1, help="At most this many images, drawn at random.")
    ] = 1000,
    images: Annotated[
        str, typer.Option("--images", help="plausible (of poses), sighting (of pairs), or both.")
    ] = "plausible,sighting",
    weights: PoseWeightsPath = None,
    floor: Annotated[
        bool | None, typer.Option("--floor/--no-floor", help="Whether the floor is known; both by default.")
    ] = None,
    unseen: Unseen = False,
    seed: Annotated[int, typer.Option("--seed", min=0, help="Seed of the draw of images.")] = 0,
    folder: Report = Path("report"),
    record: Record = False,
    records: Records = None,
    workers: Workers = CORES,
) -> None:
    """Measure how well the relative pose is read from images, and write the report."""
    with needs_extra("learn", "an evaluation"):
        from rendezvous.commands.evaluate.relative_pose import POSE_RECORDS, PoseEvaluation
        from rendezvous.commands.evaluate.relative_pose import evaluate_pose as evaluated

    page = evaluated(
        PoseEvaluation(
            dataset=dataset_folder(data),
            split=split,
            count=count,
            kinds=_names(images),
            weights=weights,
            floor=floor,
            unseen=unseen,
            seed=seed,
            folder=folder,
            workers=workers,
            records=_records(records, POSE_RECORDS, record=record),
            record=record,
        )
    )
    print(page)


def evaluate(
    data: Data = "data",
    split: Split = "test",
    count: Count = None,
    methods: Annotated[
        str, typer.Option("--methods", help="identity,correlative,...; all that can run by default.")
    ] = "",
    weights: Annotated[
        list[str],
        typer.Option("--weights", metavar="NAME=PATH", help="Weights of a trained method; may be repeated."),
    ] = [],  # noqa: B006 - Typer reads the default, nothing writes it
    xy_range_m: Annotated[
        float, typer.Option("--xy-range-m", help="Frame errors within ± this in x and y.")
    ] = 2.0,
    yaw_range_deg: Annotated[
        float, typer.Option("--yaw-range-deg", help="Frame errors within ± this in heading.")
    ] = 45.0,
    seed: Annotated[int, typer.Option("--seed", min=0, help="Seed of the frame errors.")] = 0,
    folder: Report = Path("report"),
    record: Record = False,
    records: Records = None,
    workers: Workers = CORES,
) -> None:
    """Measure how well frame errors are found, by every method, and write the report."""
    with needs_extra("learn", "an evaluation"):
        from rendezvous.commands.evaluate.frame_error import RECORDS, Evaluation
        from rendezvous.commands.evaluate.frame_error import evaluate as evaluated

    page = evaluated(
        Evaluation(
            dataset=dataset_folder(data),
            split=split,
            count=count,
            methods=_names(methods),
            weights=_named_paths("--weights", weights),
            xy_range_m=xy_range_m,
            yaw_range_deg=yaw_range_deg,
            seed=seed,
            folder=folder,
            workers=workers,
            records=_records(records, RECORDS, record=record),
            record=record,
        )
    )
    print(page)


def evaluate_fusion(
    data: Data = "data",
    split: Split = "test",
    count: Count = None,
    methods: Annotated[
        str, typer.Option("--methods", help="none,hough,orb,correlative,learned,auto; all by default.")
    ] = "",
    weights: PoseWeightsPath = None,
    unseen: Unseen = False,
    seed: Annotated[int, typer.Option("--seed", min=0, help="Seed of the draw of rendezvous.")] = 0,
    folder: Report = Path("report"),
    record: Record = False,
    records: Records = None,
    workers: Workers = CORES,
) -> None:
    """Measure the whole system, from one image and two maps to one map, and write the report."""
    with needs_extra("learn", "an evaluation"):
        from rendezvous.commands.evaluate.fusion import FUSION_RECORDS, FusionEvaluation
        from rendezvous.commands.evaluate.fusion import evaluate_fusion as evaluated

    page = evaluated(
        FusionEvaluation(
            dataset=dataset_folder(data),
            split=split,
            count=count,
            methods=_names(methods),
            weights=weights,
            unseen=unseen,
            seed=seed,
            folder=folder,
            workers=workers,
            records=_records(records, FUSION_RECORDS, record=record),
            record=record,
        )
    )
    print(page)


def evaluate_all(
    data: Data = "data",
    split: Split = "test",
    count: Annotated[
        int | None, typer.Option("--count", min=1, help="At most this many pairs, and images.")
    ] = None,
    folder: Report = Path("report"),
    workers: Workers = CORES,
) -> None:
    """Run all three evaluations, as far as there are images and weights for them, into one report."""
    with needs_extra("learn", "an evaluation"):
        from rendezvous.commands.evaluate.all import EveryEvaluation
        from rendezvous.commands.evaluate.all import evaluate_all as evaluated

    print(
        evaluated(
            EveryEvaluation(
                dataset=dataset_folder(data), split=split, count=count, folder=folder, workers=workers
            )
        )
    )


def _records(given: Path | None, shipped: Path, *, record: bool) -> Path:
    """The folder of kept figures.

    Raises:
        ConfigError: they would be kept among the files of an installed package.
    """
    if record and given is None and not IN_CHECKOUT:
        raise ConfigError("--record: would write to the installed package; --records names another folder")
    return given or shipped


def _named_paths(option: str, given: list[str]) -> dict[str, Path]:
    """The NAME=PATH values of a repeated option."""
    found = {}
    for item in given:
        name, equals, path = item.partition("=")
        if not (name and equals and path):
            raise ConfigError(f"{option} is {item!r}; must be NAME=PATH")
        found[name] = Path(path)
    return found


def _names(given: str) -> tuple[str, ...]:
    """The names in a list separated by commas."""
    return tuple(name.strip() for name in given.split(",") if name.strip())
