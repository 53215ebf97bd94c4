"""The commands that train networks and calibrate their confidence."""

from __future__ import annotations

import os
import sys
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from rendezvous.cli.options import (
    CORES,
    Config,
    Data,
    Overrides,
    Preset,
    Seed,
    Workers,
    dataset_folder,
    make_run,
)
from rendezvous.errors import StoreError, needs_extra
from rendezvous.stages import stage_function

if TYPE_CHECKING:
    from rendezvous.engine.run import Run

Minutes = Annotated[float | None, typer.Option("--minutes", help="How long to train.")]
Resume = Annotated[
    bool, typer.Option("--resume", help="Continue from the checkpoint in the folder, if there is one.")
]


def train(
    model: Annotated[
        str | None, typer.Option("--model", help="matcher, or a row of the paper's table: vit-reg-lie, ...")
    ] = None,
    minutes: Minutes = None,
    resume: Resume = False,
    out: Annotated[
        Path | None, typer.Option("--out", help="Folder of checkpoint and weights; runs/MODEL by default.")
    ] = None,
    config: Config = None,
    preset: Preset = "default",
    overrides: Overrides = [],  # noqa: B006 - Typer reads the default, nothing writes it
    data: Data = "data",
    workers: Workers = CORES,
    seed: Seed = None,
) -> None:
    """Train the frame-error estimator on the published pairs."""
    given = {"train.model": model, "train.minutes": minutes}
    run = make_run(config, preset, [*overrides, *_overrides(given)], data, workers, seed, "local")
    _train("train", run, out=out, resume=resume)


def train_pose(
    minutes: Minutes = None,
    resume: Resume = False,
    out: Annotated[
        Path | None,
        typer.Option("--out", help="Folder of checkpoint and weights; runs/relative-pose by default."),
    ] = None,
    config: Config = None,
    preset: Preset = "default",
    overrides: Overrides = [],  # noqa: B006 - Typer reads the default, nothing writes it
    data: Data = "data",
    workers: Workers = CORES,
    seed: Seed = None,
) -> None:
    """Train the relative-pose network on the published images of the robot."""
    given = {"train_pose.minutes": minutes}
    run = make_run(config, preset, [*overrides, *_overrides(given)], data, workers, seed, "local")
    _train("train_pose", run, out=out, resume=resume)


def _overrides(given: dict[str, Any]) -> list[str]:
    """Options that set parameters, as `--set` would."""
    return [f"{key}={value}" for key, value in given.items() if value is not None]


def _train(stage: str, run: Run, *, out: Path | None, resume: bool) -> None:
    # Read when torch is imported: threads that wait for each other shall sleep. On a machine that also does
    # something else, such as drawing samples, spinning makes a step up to twenty times slower.
    os.environ.setdefault("OMP_WAIT_POLICY", "passive")
    with needs_extra("learn", "training"):
        trained = stage_function(stage)
    try:
        trained(run, out=out, resume=resume)
    except KeyboardInterrupt as interrupt:
        print("rendezvous: interrupted; --resume continues from the last checkpoint", file=sys.stderr)
        raise typer.Exit(130) from interrupt


def calibrate(
    weights: Annotated[Path, typer.Argument(help="A matcher's weights.safetensors.")] = Path(
        "runs/matcher/weights.safetensors"
    ),
    data: Data = "data",
    seed: Annotated[int, typer.Option("--seed", min=0, help="Seed of the frame errors.")] = 0,
    workers: Workers = CORES,
) -> None:
    """Calibrate a matcher's confidence on validation pairs, as `train` does."""
    _calibrate("calibrate", weights, data, seed, workers)


def calibrate_pose(
    weights: Annotated[Path, typer.Argument(help="A relative-pose network's weights.safetensors.")] = Path(
        "runs/relative-pose/weights.safetensors"
    ),
    data: Data = "data",
    seed: Annotated[int, typer.Option("--seed", min=0, help="Seed of the draw of images.")] = 0,
    workers: Workers = CORES,
) -> None:
    """Calibrate a relative-pose network's confidence on validation images, as `train-pose` does."""
    _calibrate("calibrate_pose", weights, data, seed, workers)


def _calibrate(name: str, weights: Path, data: str, seed: int, workers: int) -> None:
    from rich.console import Console

    if not weights.is_file():
        makes = "train-pose" if name == "calibrate_pose" else "train"
        raise StoreError(f"{weights}: no such file; must be weights that `rendezvous {makes}` writes")
    with needs_extra("learn", "calibration"):
        calibrated = getattr(import_module(f"rendezvous.stages.training.{name}"), name)
    calibrated(weights, dataset_folder(data), seed=seed, threads=workers, console=Console(stderr=True))
