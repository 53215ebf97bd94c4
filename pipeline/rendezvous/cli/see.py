"""The command that says what the pose network sees in an image."""

from __future__ import annotations

import sys
import warnings
from pathlib import Path
from typing import Annotated

import typer

from rendezvous.commands.fuse.arguments import numbers
from rendezvous.errors import ConfigError


def see(
    image: Annotated[list[Path], typer.Argument(help="Images taken by one camera.")],
    camera: Annotated[
        Path, typer.Option("--camera", help="ROS camera_info YAML of the camera that took them.")
    ],
    camera_pose: Annotated[
        str | None,
        typer.Option(
            "--camera-pose",
            metavar="X,Y,Z,ROLL,PITCH,YAW",
            help="The camera's body, x forward, on robot 0 (m, rad); as on --robot by default.",
        ),
    ] = None,
    robot: Annotated[str, typer.Option("--robot", help="A shipped robot or a robot file.")] = "burger",
    out: Annotated[Path, typer.Option("--out", help="Folder to write pictures to.")] = Path("seen"),
) -> None:
    """Find the robot in images, without maps: its pose, how sure that is, and a picture."""
    mounted = None if camera_pose is None else numbers("--camera-pose", camera_pose, "x,y,z,roll,pitch,yaw")
    if out.exists() and not out.is_dir():
        raise ConfigError(f"--out is {str(out)!r}, a file; must be a folder")

    from rendezvous.commands.see import see as seen_in
    from rendezvous.commands.see import write_seen

    with warnings.catch_warnings():
        warnings.simplefilter("always", UserWarning)
        warnings.showwarning = lambda message, *_, **__: print(f"rendezvous: {message}", file=sys.stderr)
        seen = seen_in(image, camera, camera_pose=mounted, robot=robot)
    for one in seen:
        print(*one.lines(), sep="\n")
    print(*write_seen(seen, out), sep=", ")
