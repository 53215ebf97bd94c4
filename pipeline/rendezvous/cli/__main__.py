"""The command line: a command for each stage, in flow order, then those that use what the stages made."""

from __future__ import annotations

import sys
import tempfile
from importlib import metadata
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from rendezvous.cli.evaluate import evaluate, evaluate_all, evaluate_fusion, evaluate_pose
from rendezvous.cli.example import example
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
from rendezvous.cli.replay import replay
from rendezvous.cli.robot_sheet import robot_sheet
from rendezvous.cli.see import see
from rendezvous.cli.slam import slam
from rendezvous.cli.streams import spell_out_what_the_encoding_lacks
from rendezvous.cli.train import calibrate, calibrate_pose, train, train_pose
from rendezvous.config.stage_table import DATASET_STAGES, STAGES
from rendezvous.errors import PipelineError
from rendezvous.stages import stage_function

if TYPE_CHECKING:
    from rendezvous.engine.run import Run


class _OneLineErrors(typer.core.TyperGroup):
    """Prints errors that the user can fix as one line; other errors keep their traceback."""

    def invoke(self, ctx: Any) -> Any:
        try:
            return super().invoke(ctx)
        except PipelineError as error:
            print(f"rendezvous: {' '.join(str(error).split())}", file=sys.stderr)
            raise typer.Exit(2) from error
        except OSError as error:
            if _has_temporary_folder():
                raise
            reason = " ".join(str(error).split())
            print(
                "rendezvous: there is no folder for temporary files, which some packages need; set TMPDIR to "
                f"one that can be written to ({reason})",
                file=sys.stderr,
            )
            raise typer.Exit(2) from error
        except KeyboardInterrupt as interrupt:
            print(
                "rendezvous: interrupted; what was finished is kept: run the same command again to go on",
                file=sys.stderr,
            )
            raise typer.Exit(130) from interrupt


def _has_temporary_folder() -> bool:
    try:
        tempfile.gettempdir()
    except FileNotFoundError:
        return False
    return True


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
    """Options of the program itself."""


def _dataset_command(name: str, about: str) -> None:
    """Add the command of one stage, or of all."""

    @app.command(name, help=about)
    def command(
        config: Config = None,
        preset: Preset = "default",
        overrides: Overrides = [],  # noqa: B006 - Typer reads the default, nothing writes it
        data: Data = "data",
        workers: Workers = CORES,
        seed: Seed = None,
        engine: EngineName = "local",
    ) -> None:
        run = make_run(config, preset, overrides, data, workers, seed, engine)
        if name in STAGES:
            stage_function(name)(run)
        else:
            _make_dataset(run)


def _make_dataset(run: Run) -> None:
    """Run all stages; check at the start what would make the last ones fail hours later."""
    from rendezvous.stages.render import check_pictures

    check_pictures(run)
    for stage in DATASET_STAGES:
        stage_function(stage)(run)
        if stage == "floorplans":
            from rendezvous.stages.pack import check_splits

            check_splits(run.config.pack, run.read("floorplans"))
    run.say(f"dataset: written to {run.folder('pack')}, whose README.md describes it")


for _stage in DATASET_STAGES:
    _dataset_command(_stage, STAGES[_stage].about)
_dataset_command("dataset", "All of the above, in order.")
app.command(help=STAGES["replay"].about)(replay)
app.command(help=STAGES["train"].about)(train)
app.command(help=STAGES["train_pose"].about)(train_pose)
for _command in (
    *(calibrate, calibrate_pose),
    *(fuse, see, slam, example, robot_sheet),
    *(evaluate_pose, evaluate, evaluate_fusion, evaluate_all),
):
    app.command()(_command)
app.add_typer(export_app, name="export")


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
    seed: Annotated[int, typer.Option("--seed", min=0, help="Seed of the random draw.")] = 0,
) -> None:
    """Draw contact sheets of a stage's output and print its figures."""
    from rendezvous.commands.inspect import Order, Selection, ShownTable
    from rendezvous.commands.inspect import inspect as inspected

    found = inspected(
        folder,
        output=out,
        table=None if table is None else choice(ShownTable, "--table", table),
        selection=Selection(
            count=count, order=None if order is None else choice(Order, "--order", order), seed=seed
        ),
    )
    print(found.summary, end="\n\n")
    print(*found.pictures, sep="\n")


def main() -> None:
    """Run the command line."""
    spell_out_what_the_encoding_lacks()
    app()


if __name__ == "__main__":
    main()
