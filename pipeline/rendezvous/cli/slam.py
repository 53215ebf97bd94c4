"""The command that maps a recorded laser log."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from rendezvous.cli.options import Config, Overrides, choice
from rendezvous.commands.fuse.arguments import numbers
from rendezvous.errors import ConfigError
from rendezvous.resources import located

Poses = Annotated[
    str,
    typer.Option(
        "--poses",
        help="What the poses in a CARMEN log are: odometry, reference (corrected afterwards), or auto.",
    ),
]
RangeMax = Annotated[
    float | None,
    typer.Option("--range-max", min=0.1, help="Readings from here on are no echo [m]; found out by default."),
]


def slam(
    log: Annotated[Path, typer.Argument(help="A CARMEN log (.log, .clf, .gz) or a ROS bag.")],
    out: Annotated[Path, typer.Option("--out", help="Folder to write the map and the path to.")] = Path(
        "slam"
    ),
    reference: Annotated[
        Path | None, typer.Option("--reference", help="The true path, in TUM's format with the log's stamps.")
    ] = None,
    relations: Annotated[
        Path | None, typer.Option("--relations", help="Kümmerle's relations of the log.")
    ] = None,
    poses: Poses = "auto",
    range_max: RangeMax = None,
    topic: Annotated[
        str | None, typer.Option("--topic", help="Of the scans in a ROS bag, if there are several.")
    ] = None,
    lidar_pose: Annotated[
        str | None,
        typer.Option(
            "--lidar-pose",
            metavar="X,Y,Z,ROLL,PITCH,YAW",
            help="The lidar on the robot (m, rad); from a bag's transforms by default.",
        ),
    ] = None,
    loops: Annotated[
        bool, typer.Option("--loops/--no-loops", help="Recognise places seen before and correct the path.")
    ] = True,
    loop_search: Annotated[
        str,
        typer.Option("--loop-search", help="What recognises them: correlative, or matcher (needs PyTorch)."),
    ] = "correlative",
    config: Config = None,
    overrides: Overrides = [],  # noqa: B006 - Typer reads the default, nothing writes it
    seed: Annotated[int, typer.Option("--seed", min=0, help="Of odometry drawn for a log without.")] = 0,
) -> None:
    """Map a recorded laser log; measure the path against reference poses or relations.

    SLAM has the parameters of the stage `replay`.
    """
    mounted = None if lidar_pose is None else numbers("--lidar-pose", lidar_pose, "x,y,z,roll,pitch,yaw")
    if out.exists() and not out.is_dir():
        raise ConfigError(f"--out is {str(out)!r}, a file; must be a folder")

    from rendezvous.commands.slam import LoopSearch, run_slam, write_slam
    from rendezvous.config.load import load_config
    from rendezvous.interop.carmen_log import PosesOf
    from rendezvous.interop.laser_logs import read_laser_log

    search = choice(LoopSearch, "--loop-search", loop_search)
    read = read_laser_log(
        log,
        poses=choice(PosesOf, "--poses", poses),
        range_max_m=range_max,
        reference=reference,
        topic=topic,
        lidar_pose=mounted,
    )
    section = load_config(config or located("stages.yaml"), overrides=overrides).replay
    run = run_slam(
        read,
        relations=relations,
        parameters=section.slam,
        lidar=section.lidar,
        noise=section.odometry,
        seed=seed,
        loops=search if loops else None,
    )
    files = write_slam(run, out)
    print(*run.lines(), sep="\n")
    print(*files, sep=", ")
