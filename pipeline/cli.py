"""The command line: one command per stage, in flow order, then what looks at the data."""

from __future__ import annotations

import sys
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from pipeline.cli_export import export_app
from pipeline.cli_fuse import fuse
from pipeline.cli_options import (
    CORES,
    Config,
    Data,
    EngineName,
    Overrides,
    Preset,
    Seed,
    Workers,
    choice,
    data_folder,
    make_run,
)
from pipeline.cli_train import calibrate, train, train_pose
from pipeline.errors import ConfigError, PipelineError

if TYPE_CHECKING:
    from pipeline.engine import Run

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
                "rendezvous: interrupted; finished shards are kept: run the same command again to resume",
                file=sys.stderr,
            )
            raise typer.Exit(130) from interrupt


app = typer.Typer(
    cls=_OneLineErrors,
    help="Synthetic rendezvous of two robots, from floor plans to a dataset.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    add_completion=False,
)


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
        for name in STAGES if stage == "dataset" else (stage,):
            _stage_function(name)(run)


def _stage_function(stage: str) -> Callable[[Run], Any]:
    function: Callable[[Run], Any] = getattr(import_module(f"pipeline.stages.{stage}"), stage)
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
app.command()(fuse)


@app.command()
def evaluate(
    data: Data = "data",
    split: Annotated[str, typer.Option("--split", help="train, validation or test.")] = "test",
    count: Annotated[
        int | None, typer.Option("--count", min=1, help="At most so many pairs; all by default.")
    ] = None,
    methods: Annotated[
        str, typer.Option("--methods", help="identity,correlative,...; all that can run by default.")
    ] = "",
    weights: Annotated[
        list[str],
        typer.Option("--weights", metavar="NAME=PATH", help="Of a trained method; may be repeated."),
    ] = [],  # noqa: B006 - Typer reads the default, nothing writes it
    xy_range_m: Annotated[
        float, typer.Option("--xy-range-m", help="Frame errors within ± this in x and y.")
    ] = 2.0,
    yaw_range_deg: Annotated[
        float, typer.Option("--yaw-range-deg", help="Frame errors within ± this in heading.")
    ] = 45.0,
    seed: Annotated[int, typer.Option("--seed", min=0, help="Of the frame errors.")] = 0,
    folder: Annotated[Path, typer.Option("--report", help="Folder of index.html, metrics.json.")] = Path(
        "report"
    ),
    record: Annotated[
        bool, typer.Option("--record", help="Keep the figures in assets/metrics, for later reports.")
    ] = False,
    records: Annotated[
        Path | None, typer.Option("--records", help="Folder of kept figures, instead of assets/metrics.")
    ] = None,
    workers: Workers = CORES,
) -> None:
    """Measure how well frame errors are found, by every method, and write the report."""
    from pipeline.stages.evaluate import RECORDS, Evaluation
    from pipeline.stages.evaluate import evaluate as evaluated

    page = evaluated(
        Evaluation(
            dataset=f"{data_folder(data).rstrip('/')}/dataset",
            split=split,
            count=count,
            methods=tuple(name.strip() for name in methods.split(",") if name.strip()),
            weights=_named_paths("--weights", weights),
            xy_range_m=xy_range_m,
            yaw_range_deg=yaw_range_deg,
            seed=seed,
            folder=folder,
            workers=workers,
            records=records or RECORDS,
            record=record,
        )
    )
    print(page)


def _named_paths(option: str, given: list[str]) -> dict[str, Path]:
    """What an option names as NAME=PATH."""
    found = {}
    for item in given:
        name, equals, path = item.partition("=")
        if not (name and equals and path):
            raise ConfigError(f"{option} is {item!r}; must be NAME=PATH")
        found[name] = Path(path)
    return found


@app.command()
def verify(folder: Annotated[str, typer.Argument(help="A data folder or one stage's.")] = "data") -> None:
    """Find damaged, missing and unlisted files."""
    from pipeline.store.verify import stage_folders
    from pipeline.store.verify import verify as faults_of

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
    from pipeline.stages.inspect import Order, Selection, Table
    from pipeline.stages.inspect import inspect as inspected

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
