"""The command line: one command per stage, in flow order, then what looks at the data."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from enum import StrEnum
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeVar

import typer

from pipeline.errors import ConfigError, PipelineError, SetupError

if TYPE_CHECKING:
    from pipeline.engine import Run

Choice = TypeVar("Choice", bound=StrEnum)
CORES = len(os.sched_getaffinity(0))
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
Config = Annotated[str, typer.Option("--config", help="The pipeline as data.")]
Preset = Annotated[str, typer.Option("--preset", help="smoke, default, large or paper.")]
Overrides = Annotated[
    list[str], typer.Option("--set", metavar="KEY=VALUE", help="Override a parameter; may be repeated.")
]
Data = Annotated[str, typer.Option("--data", help="Data folder, or a URI such as s3://bucket/data.")]
Workers = Annotated[int, typer.Option("--workers", min=1, help="Worker processes; all cores by default.")]
Seed = Annotated[int | None, typer.Option("--seed", min=0, help="Root seed, instead of the file's.")]
EngineName = Annotated[str, typer.Option("--engine", help="local processes, inline (debugger), or ray.")]


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
        run = _run(config, preset, overrides, data, workers, seed, engine)
        for name in STAGES if stage == "dataset" else (stage,):
            _stage_function(name)(run)


def _stage_function(stage: str) -> Callable[[Run], Any]:
    function: Callable[[Run], Any] = getattr(import_module(f"pipeline.stages.{stage}"), stage)
    return function


def _data_folder(data: str) -> str:
    """The data folder, which without a name would be the root of the file system."""
    if not data.strip():
        raise ConfigError(
            f"--data is {data!r}; must name a folder or be a URI, such as data or s3://bucket/data"
        )
    return data


def _run(
    config: str, preset: str, overrides: list[str], data: str, workers: int, seed: int | None, engine: str
) -> Run:
    from pipeline.config import load_config
    from pipeline.engine import Run
    from pipeline.pool import Engine

    return Run(
        config=load_config(config, preset=preset, overrides=overrides, seed=seed),
        data=_data_folder(data),
        workers=workers,
        engine=_choice(Engine, "--engine", engine),
    )


_stage_command("floorplans", "Read and generate floor plans; keep those that robots can explore.")
_stage_command("meshes", "Raise walls: boxes for physics, GLB and MJCF for everything else.")
_stage_command("explore", "Drive two robots through each plan until they meet.")
_stage_command("render", "Take the picture of each sighting, and training images of the robot.")
_stage_command("pack", "Publish sightings and images as a dataset, split by floor plan.")
_stage_command("dataset", "All of the above, in order.")


@app.command()
def train(
    model: Annotated[
        str | None, typer.Option("--model", help="matcher, or a row of the paper's table: vit-reg-lie, ...")
    ] = None,
    minutes: Annotated[float | None, typer.Option("--minutes", help="How long to train.")] = None,
    resume: Annotated[
        bool, typer.Option("--resume", help="Go on from the folder's checkpoint, if there is one.")
    ] = False,
    out: Annotated[
        Path | None, typer.Option("--out", help="Folder of checkpoint and weights; runs/MODEL by default.")
    ] = None,
    config: Config = "stages.yaml",
    preset: Preset = "default",
    overrides: Overrides = [],  # noqa: B006 - Typer reads the default, nothing writes it
    data: Data = "data",
    workers: Workers = CORES,
    seed: Seed = None,
) -> None:
    """Train the frame-error estimator on the published pairs."""
    given = {"model": model, "minutes": minutes}
    named = [f"train.{key}={value}" for key, value in given.items() if value is not None]
    run = _run(config, preset, [*overrides, *named], data, workers, seed, "local")
    # Read when torch is imported: threads that wait for each other shall sleep. On a machine that also does
    # something else, such as drawing samples, spinning makes a step up to twenty times slower.
    os.environ.setdefault("OMP_WAIT_POLICY", "passive")
    try:
        from pipeline.stages.train import train as trained
    except ModuleNotFoundError as error:
        raise SetupError(
            f"{error.name} is missing; `pip install 'rendezvous-fusion[learn]'` installs what training needs"
        ) from error
    try:
        trained(run, out=out, resume=resume)
    except KeyboardInterrupt as interrupt:
        print("rendezvous: interrupted; --resume goes on from the last checkpoint", file=sys.stderr)
        raise typer.Exit(130) from interrupt


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
            dataset=f"{_data_folder(data).rstrip('/')}/dataset",
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
        table=None if table is None else _choice(Table, "--table", table),
        selection=Selection(
            count=count, order=None if order is None else _choice(Order, "--order", order), seed=seed
        ),
    )
    print(found.summary, end="\n\n")
    print(*found.pictures, sep="\n")


export_app = typer.Typer(help="Write plans and images as files for other programs.", no_args_is_help=True)
app.add_typer(export_app, name="export")


@export_app.command("plan")
def export_plan(
    plan_id: Annotated[str, typer.Argument(help="Name of the plan.")],
    out: Annotated[Path, typer.Option("--out", help="Folder to write to.")] = Path("export"),
    data: Data = "data",
    config: Config = "stages.yaml",
) -> None:
    """Write a plan that `meshes` has raised: HouseExpo JSON, GLB, GLB with furniture, MJCF with robots."""
    from pipeline.stages.export import export_plan as written

    run = _run(config, "default", [], data, CORES, None, "local")
    for path in written(run.read("meshes"), plan_id, out):
        print(path)


@export_app.command("floorplans")
def export_floorplans(
    count: Annotated[int, typer.Option("--count", min=1, help="How many.")] = 24,
    out: Annotated[Path, typer.Option("--out", help="Folder to write to.")] = Path("floorplans"),
) -> None:
    """Write the floor plans that come with the project, byte for byte, or more of them."""
    from pipeline.stages.export import export_floorplans as written

    print(f"{len(written(count, out))} floor plans in {out}")


Dataset = Annotated[str, typer.Argument(help="The dataset that `pack` wrote.")]
TableName = Annotated[
    str, typer.Option("--table", help="poses: training images; pairs: what robots saw when they met.")
]
SplitName = Annotated[str, typer.Option("--split", help="train, validation, test or all.")]
ImagesOut = Annotated[Path, typer.Option("--out", help="Folder to write to.")]
ImageCount = Annotated[
    int | None, typer.Option("--count", min=1, help="At most so many images of each split; all by default.")
]


@export_app.command("dope")
def export_dope(
    out: ImagesOut,
    folder: Dataset = "data/dataset",
    table: TableName = "poses",
    split: SplitName = "train",
    count: ImageCount = None,
) -> None:
    """Write images and labels as DOPE reads them: X.png, X.json. Print lines for its configuration."""
    from rich.console import Console

    from pipeline.stages.dataset_images import Split, Table
    from pipeline.stages.export_dope import export_dope as exported

    made = exported(
        folder,
        out,
        table=_choice(Table, "--table", table),
        split=_choice(Split, "--split", split),
        count=count or sys.maxsize,
        console=Console(stderr=True),
    )
    print(made.summary())


@export_app.command("bop")
def export_bop(
    out: ImagesOut,
    folder: Dataset = "data/dataset",
    table: TableName = "poses",
    split: SplitName = "train",
    count: ImageCount = None,
    robot: Annotated[
        str | None, typer.Option("--robot", help="A shipped robot or a robot file; the dataset's by default.")
    ] = None,
) -> None:
    """Write images, labels and the robot's model in the BOP format."""
    from rich.console import Console

    from pipeline.stages.dataset_images import Split, Table
    from pipeline.stages.export_bop import export_bop as exported

    made = exported(
        folder,
        out,
        table=_choice(Table, "--table", table),
        split=_choice(Split, "--split", split),
        robot=robot,
        count=count or sys.maxsize,
        console=Console(stderr=True),
    )
    print(made.summary())


def _choice(kind: type[Choice], option: str, value: str) -> Choice:
    """A value of an enumeration that is imported only when its command runs."""
    try:
        return kind(value)
    except ValueError as error:
        known = ", ".join(kind)
        raise ConfigError(f"{option} is {value!r}; must be one of {known}") from error


def main() -> None:
    """Run the command line."""
    app()


if __name__ == "__main__":
    main()
