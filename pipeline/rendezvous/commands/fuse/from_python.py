"""Fuse two maps from Python: `from rendezvous.commands.fuse.from_python import fuse`."""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from enum import StrEnum
from importlib.util import find_spec
from pathlib import Path
from typing import Literal, TypeVar

from rendezvous.commands.fuse.fuse import FuseRequest, fused
from rendezvous.commands.fuse.inputs import CameraLike, ImageLike, MapLike
from rendezvous.commands.fuse.outputs import require_apart, write_fused
from rendezvous.errors import ConfigError
from rendezvous.fusion.merge import Merging
from rendezvous.fusion.refinement import Refinement
from rendezvous.fusion.system import FusionResult
from rendezvous.geometry.se2 import SE2, Array
from rendezvous.pose_estimation.pose_estimate import ImagePoseEstimator

PoseLike = SE2 | Sequence[float] | Array
"""x [m], y [m], yaw [rad]."""

Choice = TypeVar("Choice", bound=StrEnum)


def fuse(
    map0: MapLike,
    map1: MapLike,
    *,
    pose0: PoseLike,
    pose1: PoseLike,
    image: ImageLike | Sequence[ImageLike] | None = None,
    camera: CameraLike | None = None,
    camera_pose: Sequence[float] | None = None,
    robot: str | Path = "burger",
    relative: PoseLike | None = None,
    relative_sigma: Sequence[float] | None = None,
    refine: Literal["none", "learned", "correlative", "auto"] = "auto",
    merge: Literal["occupied", "probabilistic"] = "occupied",
    strict: bool = False,
    out: str | Path | None = None,
    pose_estimator: ImagePoseEstimator | None = None,
) -> FusionResult:
    """One global map of two robots' maps, aligned by where robot 0 saw robot 1.

    Args:
        map0, map1: YAML files of ROS maps, or `OccupancyGrid`s.
        pose0, pose1: where each robot stood in its own map at the sighting.
        image: of robot 1, taken by robot 0: a file or (H, W, 3) uint8 RGB; or several of the same sighting.
        camera: that took it: a ROS camera_info file, a `CameraInfo` or a `PinholeCamera`.
        camera_pose: x, y, z [m], roll, pitch, yaw [rad] of its body, x forward, on robot 0; as on `robot` by
            default.
        robot: a shipped robot or a robot file, of which kind both are.
        relative: pose of robot 1 in robot 0's frame, instead of an image.
        relative_sigma: standard deviations of that in x [m], y [m], yaw [rad]; not known by default.
        refine: `auto`: by the learned matcher, which takes account of how sure the sighting is; `learned`: by
            the matcher alone; `correlative`: without a network; `none`.
        merge: `occupied`: a cell is occupied where either map has it so (Algorithm 1 of the paper), so that
            no wall is lost; `probabilistic`: by both maps' weighed evidence, which removes what one of them
            saw through, and of a wall what they draw more than a cell apart.
        strict: keep to a map's thresholds also where they make its unknown cells free.
        out: folder for the map, pictures and a record; nothing is written by default.
        pose_estimator: reads the image; the trained one by default.

    Raises:
        PipelineError: what is given cannot be used, or the robot is not found; says what would be right.

    Warns:
        UserWarning: what is given can be used, and is likely not what is meant, as degrees for radians.
    """
    several = isinstance(image, Sequence) and not isinstance(image, str)
    images: Sequence[ImageLike] = image if several else [] if image is None else [image]  # type: ignore[assignment,list-item]
    request = FuseRequest(
        maps=(map0, map1),
        T_m0_r0=_pose("pose0", pose0),
        T_m1_r1=_pose("pose1", pose1),
        images=tuple(images),
        camera=camera,
        camera_pose=None if camera_pose is None else _mounted(camera_pose),
        robot=str(robot),
        T_r0_r1=None if relative is None else _pose("relative", relative),
        relative_sigma=None if relative_sigma is None else _sigma(relative_sigma),
        refine=_one_of(Refinement, "refine", refine),
        merge=_one_of(Merging, "merge", merge),
        strict=strict,
        pose_estimator=pose_estimator,
    )
    if out is not None:
        require_apart(request, Path(out))
    with _threads_kept(request):
        found = fused(request)
    if out is not None:
        write_fused(found, Path(out))
    for warning in found.warnings:
        warnings.warn(warning, stacklevel=2)
    return found.result


@contextmanager
def _threads_kept(request: FuseRequest) -> Iterator[None]:
    """The networks run in one thread; afterwards the caller has as many as before."""
    networks = request.refine.needs_matcher or (request.images and request.pose_estimator is None)
    if not networks or find_spec("torch") is None:
        yield
        return
    import torch

    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)


def _pose(name: str, given: PoseLike) -> SE2:
    return given if isinstance(given, SE2) else SE2(*_three(name, given))


def _sigma(given: Sequence[float]) -> tuple[float, float, float]:
    return _three("relative_sigma", given)


def _mounted(given: Sequence[float]) -> tuple[float, ...]:
    return _floats("camera_pose", given, 6, "x, y, z [m], roll, pitch, yaw [rad]")


def _three(name: str, given: Sequence[float] | Array) -> tuple[float, float, float]:
    x_m, y_m, yaw_rad = _floats(name, given, 3, "x [m], y [m], yaw [rad]")
    return x_m, y_m, yaw_rad


def _floats(name: str, given: Sequence[float] | Array, count: int, right: str) -> tuple[float, ...]:
    try:
        values = tuple(float(value) for value in given)
    except (TypeError, ValueError):
        values = ()
    if len(values) != count:
        raise ConfigError(f"{name} is {' '.join(repr(given).split())}; must be {right}")
    return values


def _one_of(choices: type[Choice], name: str, given: str) -> Choice:
    try:
        return choices(given)
    except ValueError as error:
        raise ConfigError(f"{name} is {given!r}; must be one of {', '.join(choices)}") from error
