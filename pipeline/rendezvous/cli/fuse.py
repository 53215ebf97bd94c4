"""The command that fuses two maps; wrong options are told before anything heavy is imported."""

from __future__ import annotations

import math
import sys
from pathlib import Path
from typing import Annotated

import typer

from rendezvous.errors import ConfigError

_REFINEMENTS = ("none", "learned", "correlative", "auto")
_MERGINGS = ("occupied", "probabilistic")


def fuse(
    map0: Annotated[Path, typer.Option("--map0", help="YAML of robot 0's ROS map; robot 0 sees robot 1.")],
    map1: Annotated[Path, typer.Option("--map1", help="YAML of robot 1's ROS map.")],
    pose0: Annotated[
        str,
        typer.Option("--pose0", metavar="X,Y,YAW", help="Robot 0 in its map as it sees robot 1 (m, m, rad)."),
    ],
    pose1: Annotated[
        str, typer.Option("--pose1", metavar="X,Y,YAW", help="Robot 1 in its map at that time (m, m, rad).")
    ],
    image: Annotated[
        list[Path], typer.Option("--image", help="What robot 0 saw; may be repeated for one sighting.")
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
            help="Robot 1 in robot 0's frame (m, m, rad), instead of an image.",
        ),
    ] = None,
    relative_sigma: Annotated[
        str | None,
        typer.Option(
            "--relative-sigma", metavar="X_M,Y_M,YAW_DEG", help="Its standard deviations (m, m, degrees)."
        ),
    ] = None,
    refine: Annotated[
        str, typer.Option("--refine", help="How the maps refine it: none, learned, correlative or auto.")
    ] = "auto",
    merge: Annotated[
        str,
        typer.Option(
            "--merge",
            help="occupied: where either map is, no wall is lost; probabilistic: by both maps' evidence.",
        ),
    ] = "occupied",
    out: Annotated[Path, typer.Option("--out", help="Folder to write to.")] = Path("fused"),
    strict: Annotated[
        bool,
        typer.Option("--strict", help="Keep to free_thresh also where it makes unknown cells (205) free."),
    ] = False,
) -> None:
    """Fuse two robots' maps into one, aligned by where one robot saw the other."""
    at_0, at_1 = numbers("--pose0", pose0, "x,y,yaw"), numbers("--pose1", pose1, "x,y,yaw")
    seen = None if relative is None else numbers("--relative", relative, "x,y,yaw")
    mounted = None if camera_pose is None else numbers("--camera-pose", camera_pose, "x,y,z,roll,pitch,yaw")
    sigma = _sigma(relative_sigma)
    _require_one_sighting(image, camera, camera_pose, relative, relative_sigma)
    for option, given, choices in (("--refine", refine, _REFINEMENTS), ("--merge", merge, _MERGINGS)):
        if given not in choices:
            raise ConfigError(f"{option} is {given!r}; must be one of {', '.join(choices)}")
    if out.exists() and not out.is_dir():
        raise ConfigError(f"--out is {str(out)!r}, a file; must be a folder")

    from rendezvous.commands.fuse.fuse import FuseRequest, fused
    from rendezvous.commands.fuse.outputs import require_apart, summary, write_fused
    from rendezvous.fusion.merge import Merging
    from rendezvous.fusion.refinement import Refinement
    from rendezvous.geometry.se2 import SE2

    request = FuseRequest(
        maps=(map0, map1),
        T_m0_r0=SE2.from_array(at_0),
        T_m1_r1=SE2.from_array(at_1),
        images=tuple(image),
        camera=camera,
        camera_pose=mounted,
        robot=robot,
        T_r0_r1=None if seen is None else SE2.from_array(seen),
        relative_sigma=sigma,
        refine=Refinement(refine),
        merge=Merging(merge),
        strict=strict,
    )
    require_apart(request, out)
    found = fused(request)
    for warning in found.warnings:
        print(f"rendezvous: {warning}", file=sys.stderr)
    write_fused(found, out)
    print(summary(found, out))


def numbers(option: str, given: str, shape: str) -> tuple[float, ...]:
    """What an option gives as numbers with commas between them.

    Raises:
        ConfigError: they are not as many finite numbers as the shape names.
    """
    names = shape.split(",")
    try:
        values = tuple(float(word) for word in given.split(","))
    except ValueError:
        values = ()
    if len(values) != len(names) or not all(map(math.isfinite, values)):
        raise ConfigError(f"{option} is {given!r}; must be {shape}: {len(names)} finite numbers")
    return values


def _sigma(given: str | None) -> tuple[float, float, float] | None:
    if given is None:
        return None
    x_m, y_m, yaw_deg = numbers("--relative-sigma", given, "x_m,y_m,yaw_deg")
    if min(x_m, y_m, yaw_deg) <= 0.0:
        raise ConfigError(f"--relative-sigma is {given!r}; standard deviations must be above 0")
    return x_m, y_m, math.radians(yaw_deg)


def _require_one_sighting(
    image: list[Path], camera: Path | None, camera_pose: str | None, relative: str | None, sigma: str | None
) -> None:
    """Options that belong together, and those that do not."""
    if image and relative is not None:
        raise ConfigError("--image and --relative: give one of them; both say where robot 1 stood")
    if not image and relative is None:
        raise ConfigError("fuse: give --image with --camera, or --relative: where did robot 0 see robot 1?")
    if image and camera is None:
        raise ConfigError(
            "--image: --camera is missing; give the camera_info YAML of the camera that took it"
        )
    if image and sigma is not None:
        raise ConfigError("--relative-sigma: is of --relative; an image tells its own error")
    for option, value in (("--camera", camera), ("--camera-pose", camera_pose)):
        if relative is not None and value is not None:
            raise ConfigError(f"{option}: is of --image; --relative needs no camera")
