"""The command line: one command per stage, in flow order, then what looks at the data."""

from __future__ import annotations

import sys
from collections.abc import Callable
from importlib import import_module, metadata
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from rendezvous.cli.evaluate import evaluate, evaluate_all, evaluate_fusion, evaluate_pose
from rendezvous.cli.export import export_app
from rendezvous.cli.fuse import fuse
from rendezvous.cli.options import (
    CORES,
    Config,
    Data,
    EngineName,
    Overrides,
    Preset,
    Seed,
    Workers,
    choice,
    make_run,
)
from rendezvous.cli.train import calibrate, calibrate_pose, train, train_pose
from rendezvous.errors import PipelineError

if TYPE_CHECKING:
    from rendezvous.engine.run import Run

STAGES = ("floorplans", "meshes", "explore", "render", "pack")


class _OneLineErrors(typer.core.TyperGroup):
    """What the user can fix is said in one line; anything else keeps its traceback."""

    def invoke(self, ctx: Any) -> Any:
        try:
            return super().invoke(ctx)
        except PipelineError as error:
            print(f"rendezvous: {' '.join(str(error).split())}", file=sys.stderr)
            raise typer.Exit(2) from error
        except KeyboardInterrupt as interrupt:
            print(
                "rendezvous: interrupted; what was finished is kept: run the same command again to go on",
                file=sys.stderr,
            )
            raise typer.Exit(130) from interrupt


app = typer.Typer(
    cls=_OneLineErrors,
    help="Fuse the maps of two robots that met; make the data to train and measure that on.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    add_completion=False,
)


def _show_version(wanted: bool) -> None:
    if wanted:
        print(f"rendezvous {metadata.version('rendezvous-fusion')}")
        raise typer.Exit


@app.callback()
def options(
    version: Annotated[
        bool, typer.Option("--version", callback=_show_version, is_eager=True, help="Show the version.")
    ] = False,
) -> None:
    """What goes for all commands."""


def _stage_command(stage: str, help_text: str) -> None:
    """Add a stage's command. Its module is imported when it runs, so that help comes at once."""

    @app.command(stage, help=help_text)
    def command(
        config: Config = "stages.yaml",
        preset: Preset = "default",
        overrides: Overrides = [],  # noqa: B006 - Typer reads the default, nothing writes it
        data: Data = "data",
        workers: Workers = CORES,
        seed: Seed = None,
        engine: EngineName = "local",
    ) -> None:
        run = make_run(config, preset, overrides, data, workers, seed, engine)
        if stage == "dataset":
            _make_dataset(run)
        else:
            _stage_function(stage)(run)


def _make_dataset(run: Run) -> None:
    """All stages; what would stop the last ones is told before the long ones begin."""
    from rendezvous.stages.dataset.foresight import check_pictures, check_splits

    check_pictures(run)
    for stage in STAGES:
        _stage_function(stage)(run)
        if stage == "floorplans":
            check_splits(run)


def _stage_function(stage: str) -> Callable[[Run], Any]:
    function: Callable[[Run], Any] = getattr(import_module(f"rendezvous.stages.{stage}"), stage)
    return function


_stage_command("floorplans", "Read and generate floor plans; keep those that robots can explore.")
_stage_command("meshes", "Raise walls: boxes for physics, GLB and MJCF for everything else.")
_stage_command("explore", "Drive two robots through each plan until they meet.")
_stage_command("render", "Take the picture of each sighting, and training images of the robot.")
_stage_command("pack", "Publish sightings and images as a dataset, split by floor plan.")
_stage_command("dataset", "All of the above, in order.")


app.command()(train)
app.command()(train_pose)
app.command()(calibrate)
app.command()(calibrate_pose)
app.command()(fuse)
app.command()(evaluate_pose)
app.command()(evaluate)
app.command()(evaluate_fusion)
app.command()(evaluate_all)


@app.command()
def verify(folder: Annotated[str, typer.Argument(help="A data folder or one stage's.")] = "data") -> None:
    """Find damaged, missing and unlisted files."""
    from rendezvous.store.verify import stage_folders
    from rendezvous.store.verify import verify as faults_of

    folders = stage_folders(folder)
    faults = [fault for stage_folder in folders for fault in faults_of(stage_folder)]
    for fault in faults:
        print(fault)
    if faults:
        raise typer.Exit(1)
    print(f"{', '.join(folders)}: sound")


@app.command()
def inspect(
    folder: Annotated[str, typer.Argument(help="One stage's folder.")] = "data/dataset",
    out: Annotated[Path | None, typer.Option("--out", help="PNG to write; in report/ by default.")] = None,
    table: Annotated[
        str | None, typer.Option("--table", help="pairs, views or poses; all there are by default.")
    ] = None,
    count: Annotated[
        int | None, typer.Option("--count", min=1, help="How many to show; 24 images or 6 others by default.")
    ] = None,
    order: Annotated[
        str | None,
        typer.Option("--order", help="overlap (pairs) or visibility (images), from low to high; or random."),
    ] = None,
    seed: Annotated[int, typer.Option("--seed", min=0, help="Of the random draw.")] = 0,
) -> None:
    """Draw contact sheets of a stage's output and print its figures."""
    from rendezvous.commands.inspect import Order, Selection, Table
    from rendezvous.commands.inspect import inspect as inspected

    found = inspected(
        folder,
        output=out,
        table=None if table is None else choice(Table, "--table", table),
        selection=Selection(
            count=count, order=None if order is None else choice(Order, "--order", order), seed=seed
        ),
    )
    print(found.summary, end="\n\n")
    print(*found.pictures, sep="\n")


app.add_typer(export_app, name="export")


def main() -> None:
    """Run the command line."""
    app()


if __name__ == "__main__":
    main()
