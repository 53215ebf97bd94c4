"""The commands that write files for other programs."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer

from rendezvous.cli.options import CORES, Config, Data, choice, make_run

export_app = typer.Typer(help="Write plans and images as files for other programs.", no_args_is_help=True)


@export_app.command("plan")
def export_plan(
    plan_id: Annotated[str, typer.Argument(help="Name of the plan.")],
    out: Annotated[Path, typer.Option("--out", help="Folder to write to.")] = Path("export"),
    data: Data = "data",
    config: Config = None,
) -> None:
    """Write a plan that `meshes` has raised: HouseExpo JSON, GLB, GLB with furniture, MJCF with robots."""
    from rendezvous.commands.export.plan import export_plan as written

    run = make_run(config, "default", [], data, CORES, None, "local")
    for path in written(run.read("meshes"), plan_id, out):
        print(path)


@export_app.command("floorplans")
def export_floorplans(
    count: Annotated[int, typer.Option("--count", min=1, help="How many.")] = 24,
    out: Annotated[Path, typer.Option("--out", help="Folder to write to.")] = Path("floorplans"),
) -> None:
    """Write the floor plans that come with the project, byte for byte, or more of them."""
    from rendezvous.commands.export.plan import export_floorplans as written

    print(f"{len(written(count, out))} floor plans in {out}")


Dataset = Annotated[str, typer.Argument(help="The dataset that `pack` wrote.")]
TableName = Annotated[
    str, typer.Option("--table", help="poses: training images; pairs: what robots saw when they met.")
]
SplitName = Annotated[str, typer.Option("--split", help="train, validation, test or all.")]
ImagesOut = Annotated[Path, typer.Option("--out", help="Folder to write to.")]
ImageCount = Annotated[
    int | None, typer.Option("--count", min=1, help="At most this many images of each split; all by default.")
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

    from rendezvous.commands.export.dataset_images import ImageTable, Split
    from rendezvous.commands.export.dope import export_dope as exported

    made = exported(
        folder,
        out,
        table=choice(ImageTable, "--table", table),
        split=choice(Split, "--split", split),
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

    from rendezvous.commands.export.bop import export_bop as exported
    from rendezvous.commands.export.dataset_images import ImageTable, Split

    made = exported(
        folder,
        out,
        table=choice(ImageTable, "--table", table),
        split=choice(Split, "--split", split),
        robot=robot,
        count=count or sys.maxsize,
        console=Console(stderr=True),
    )
    print(made.summary())


@export_app.command("sighting")
def export_sighting(
    out: Annotated[Path, typer.Option("--out", help="Folder to write to.")],
    pair: Annotated[
        str | None, typer.Option("--pair", help="Its pair_id; the first of the test split by default.")
    ] = None,
    folder: Dataset = "data/dataset",
) -> None:
    """Write a pair as files that `rendezvous fuse` takes, and print the command that fuses them."""
    from rendezvous.commands.export.sighting import export_sighting as exported

    print(exported(folder, pair, out))
