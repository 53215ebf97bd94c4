"""Fuse two maps from Python, `from rendezvous import fuse`; the command calls the same function."""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from rendezvous.commands.fuse.arguments import MERGINGS, REFINEMENTS, Merge, Refine, require_one_of
from rendezvous.commands.fuse.fuse import FuseRequest, fused
from rendezvous.commands.fuse.inputs import CameraLike, ImageLike, MapLike
from rendezvous.commands.fuse.outputs import require_apart, write_fused
from rendezvous.errors import ConfigError
from rendezvous.fusion.merge import Merging
from rendezvous.fusion.refinement import Refinement
from rendezvous.fusion.system import FusionResult
from rendezvous.geometry.se2 import SE2, Array
from rendezvous.pose_estimation.pose_estimate import ImagePoseEstimator

PoseLike = SE2 | Sequence[float] | Array  # x [m], y [m], yaw [rad]


def fuse(
    map0: MapLike,
    map1: MapLike,
    *,
    pose0: PoseLike,
    pose1: PoseLike,
    image: ImageLike | Sequence[ImageLike] | None = None,
    camera: CameraLike | None = None,
    camera_pose: Sequence[float] | Array | None = None,
    robot: str | Path = "burger",
    relative: PoseLike | None = None,
    relative_sigma: Sequence[float] | Array | None = None,
    refine: Refine = "auto",
    merge: Merge = "occupied",
    strict: bool = False,
    out: str | Path | None = None,
    pose_estimator: ImagePoseEstimator | None = None,
) -> FusionResult:
    """Fuse two robots' maps into one, aligned by where robot 0 saw robot 1.

    Args:
        map0, map1: YAML files of ROS maps, or `OccupancyGrid`s.
        pose0, pose1: pose of each robot in its own map at the sighting.
        image: of robot 1, taken by robot 0: a file or (H, W, 3) uint8 RGB; or several of the same sighting.
            A file is read as it is stored, whatever its EXIF orientation.
        camera: that took the images: a ROS camera_info file, a `CameraInfo` or a `PinholeCamera`.
        camera_pose: x, y, z [m], roll, pitch, yaw [rad] of its body, x forward, on robot 0; by default as on
            `robot`.
        robot: the kind of both robots: a shipped robot or a robot file.
        relative: pose of robot 1 in robot 0's frame, instead of images.
        relative_sigma: standard deviations of that in x [m], y [m], yaw [rad]; unknown by default.
        refine: `auto`: by the learned matcher, which takes account of how sure the sighting is; `learned`: by
            the matcher alone; `correlative`: without a network; `none`.
        merge: `occupied`: a cell is occupied where either map has it so (Algorithm 1 of the paper), so that
            no wall is lost; `probabilistic`: by both maps' weighed evidence, which removes what one of them
            saw through, and those parts of a wall that they draw more than a cell apart.
        strict: keep to a map's thresholds where they make its unknown cells free.
        out: folder for the map, pictures and a record; nothing is written by default.
        pose_estimator: reads the images; the trained one by default.

    Raises:
        PipelineError: an input cannot be used, or the robot is not found; says what would be right.

    Warns:
        UserWarning: an input can be used but is probably not what was meant, such as degrees for radians.
    """
    require_one_of("refine", refine, REFINEMENTS)
    require_one_of("merge", merge, MERGINGS)
    several = isinstance(image, Sequence) and not isinstance(image, str)
    images: Sequence[ImageLike] = image if several else [] if image is None else [image]  # type: ignore[assignment,list-item]
    request = FuseRequest(
        maps=(map0, map1),
        T_m0_r0=_pose("pose0", pose0),
        T_m1_r1=_pose("pose1", pose1),
        images=tuple(images),
        camera=camera,
        camera_pose=None if camera_pose is None else _floats("camera_pose", camera_pose, _SIX),
        robot=str(robot),
        T_r0_r1=None if relative is None else _pose("relative", relative),
        relative_sigma=None if relative_sigma is None else _three("relative_sigma", relative_sigma),
        refine=Refinement(refine),
        merge=Merging(merge),
        strict=strict,
        pose_estimator=pose_estimator,
    )
    folder = None if out is None else _folder(out)
    if folder is not None:
        require_apart(request, folder)
    with _threads_kept(request):
        found = fused(request)
    if folder is not None:
        write_fused(found, folder)
    for warning in found.warnings:
        warnings.warn(warning, stacklevel=2)
    return found.result


@contextmanager
def _threads_kept(request: FuseRequest) -> Iterator[None]:
    """The networks run in one thread; afterwards the caller has as many as before."""
    if not request.refine.needs_matcher and (not request.images or request.pose_estimator is not None):
        yield
        return
    try:
        import torch
    except ModuleNotFoundError:  # whatever needs it says so
        yield
        return
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)


def _folder(out: str | Path) -> Path:
    try:
        return Path(out)
    except TypeError as error:
        raise ConfigError(
            f"out is {' '.join(repr(out).split())}; must be a folder's name, or None"
        ) from error


_SIX = "x, y, z [m], roll, pitch, yaw [rad]"


def _pose(name: str, given: PoseLike) -> SE2:
    return SE2(*_three(name, given.as_array() if isinstance(given, SE2) else given))


def _three(name: str, given: Sequence[float] | Array) -> tuple[float, float, float]:
    x_m, y_m, yaw_rad = _floats(name, given, "x [m], y [m], yaw [rad]")
    return x_m, y_m, yaw_rad


def _floats(name: str, given: Sequence[float] | Array, shape: str) -> tuple[float, ...]:
    """As many numbers as the shape has commas and one more."""
    try:
        values = tuple(float(value) for value in given)
    except (TypeError, ValueError, OverflowError):
        values = ()
    if len(values) != shape.count(",") + 1:
        raise ConfigError(f"{name} is {' '.join(repr(given).split())}; must be {shape}")
    return values
