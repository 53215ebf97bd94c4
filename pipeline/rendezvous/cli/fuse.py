"""The command that fuses two maps; it checks its options before it imports anything heavy."""

from __future__ import annotations

import math
import sys
import warnings
from pathlib import Path
from typing import Annotated, cast

import typer

from rendezvous.commands.fuse.arguments import (
    MERGINGS,
    REFINEMENTS,
    Merge,
    Refine,
    numbers,
    require_one_of,
    require_one_sighting,
    require_sigma,
)
from rendezvous.errors import ConfigError


def fuse(
    map0: Annotated[Path, typer.Option("--map0", help="YAML of robot 0's ROS map; robot 0 sees robot 1.")],
    map1: Annotated[Path, typer.Option("--map1", help="YAML of robot 1's ROS map.")],
    pose0: Annotated[
        str,
        typer.Option(
            "--pose0", metavar="X,Y,YAW", help="Pose of robot 0 in its map as it sees robot 1 (m, m, rad)."
        ),
    ],
    pose1: Annotated[
        str,
        typer.Option(
            "--pose1", metavar="X,Y,YAW", help="Pose of robot 1 in its map at that time (m, m, rad)."
        ),
    ],
    image: Annotated[
        list[Path], typer.Option("--image", help="Image of robot 1, taken by robot 0; repeat for several.")
    ] = [],  # noqa: B006 - Typer reads the default, nothing writes it
    camera: Annotated[
        Path | None, typer.Option("--camera", help="ROS camera_info YAML of the camera that took the image.")
    ] = None,
    camera_pose: Annotated[
        str | None,
        typer.Option(
            "--camera-pose",
            metavar="X,Y,Z,ROLL,PITCH,YAW",
            help="The camera's body, x forward, on robot 0 (m, rad); as on --robot by default.",
        ),
    ] = None,
    robot: Annotated[str, typer.Option("--robot", help="A shipped robot or a robot file.")] = "burger",
    relative: Annotated[
        str | None,
        typer.Option(
            "--relative",
            metavar="X,Y,YAW",
            help="Pose of robot 1 in robot 0's frame (m, m, rad), instead of an image.",
        ),
    ] = None,
    relative_sigma: Annotated[
        str | None,
        typer.Option(
            "--relative-sigma", metavar="X_M,Y_M,YAW_DEG", help="Its standard deviations (m, m, degrees)."
        ),
    ] = None,
    refine: Annotated[
        str,
        typer.Option(
            "--refine", help="How the maps refine the alignment: none, learned, correlative or auto."
        ),
    ] = "auto",
    merge: Annotated[
        str,
        typer.Option(
            "--merge",
            help="occupied: cells that are occupied in either map; probabilistic: both maps' evidence.",
        ),
    ] = "occupied",
    out: Annotated[Path, typer.Option("--out", help="Folder to write to.")] = Path("fused"),
    strict: Annotated[
        bool,
        typer.Option(
            "--strict", help="Read maps exactly as map_server does, even if that frees unknown cells."
        ),
    ] = False,
) -> None:
    """Fuse two robots' maps into one, aligned by where one robot saw the other."""
    at_0, at_1 = numbers("--pose0", pose0, "x,y,yaw"), numbers("--pose1", pose1, "x,y,yaw")
    seen = None if relative is None else numbers("--relative", relative, "x,y,yaw")
    mounted = None if camera_pose is None else numbers("--camera-pose", camera_pose, "x,y,z,roll,pitch,yaw")
    sigma = None if relative_sigma is None else _sigma(relative_sigma)
    require_one_sighting(
        image=bool(image),
        camera=camera is not None,
        camera_pose=camera_pose is not None,
        relative=relative is not None,
        relative_sigma=sigma is not None,
        spelt=lambda name: f"--{name.replace('_', '-')}",
    )
    require_one_of("--refine", refine, REFINEMENTS)
    require_one_of("--merge", merge, MERGINGS)
    if out.exists() and not out.is_dir():
        raise ConfigError(f"--out is {str(out)!r}, a file; must be a folder")

    from rendezvous.commands.fuse.from_python import fuse as fuse_maps
    from rendezvous.commands.fuse.outputs import summary

    with warnings.catch_warnings():
        warnings.simplefilter("always", UserWarning)
        warnings.showwarning = lambda message, *_, **__: print(f"rendezvous: {message}", file=sys.stderr)
        result = fuse_maps(
            map0,
            map1,
            pose0=at_0,
            pose1=at_1,
            image=image or None,
            camera=camera,
            camera_pose=mounted,
            robot=robot,
            relative=seen,
            relative_sigma=sigma,
            refine=cast("Refine", refine),
            merge=cast("Merge", merge),
            strict=strict,
            out=out,
        )
    print(summary(result, out))


def _sigma(given: str) -> tuple[float, float, float]:
    x_m, y_m, yaw_deg = numbers("--relative-sigma", given, "x_m,y_m,yaw_deg")
    require_sigma("--relative-sigma", (x_m, y_m, yaw_deg))
    return x_m, y_m, math.radians(yaw_deg)
