"""One fusion: read the inputs, estimate where one robot saw the other, fuse the maps."""

from __future__ import annotations

import math
import time
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from rendezvous.commands.fuse.arguments import require_one_sighting, require_sigma
from rendezvous.commands.fuse.inputs import (
    CameraLike,
    ImageLike,
    MapLike,
    Photograph,
    mounting,
    read_camera,
    read_map,
    read_photograph,
)
from rendezvous.errors import SetupError
from rendezvous.fusion.fusion_input import FusionInput, SightedPose, sighted_pose
from rendezvous.fusion.merge import Merging
from rendezvous.fusion.refinement import Refinement, Refiner, correlative_refiner, matcher_refiner
from rendezvous.fusion.system import FusionResult, fuse_maps
from rendezvous.geometry.camera import PinholeCamera
from rendezvous.geometry.cuboid import Vec3
from rendezvous.geometry.se2 import SE2
from rendezvous.pose_estimation.pose_estimate import ImagePoseEstimator, RelativePose
from rendezvous.robot_file import load_robot
from rendezvous.simulation.robot import RobotSpec
from rendezvous.stages.weights.estimators import SelectedMethod, selected_matcher, trained
from rendezvous.stages.weights.pose_source import PoseWeights, require_known_robot


@dataclass(frozen=True, slots=True, kw_only=True)
class FuseRequest:
    """The arguments of `from_python.fuse`, whose docstring says what each means; poses as `SE2`.

    `images` are those of one sighting; there are none where the relative pose `T_r0_r1` is given.
    """

    maps: tuple[MapLike, MapLike]
    T_m0_r0: SE2
    T_m1_r1: SE2
    images: Sequence[ImageLike] = ()
    camera: CameraLike | None = None
    camera_pose: tuple[float, ...] | None = None
    robot: str = "burger"
    T_r0_r1: SE2 | None = None
    relative_sigma: tuple[float, float, float] | None = None
    refine: Refinement = Refinement.AUTO
    merge: Merging = Merging.OCCUPIED
    strict: bool = False
    pose_estimator: ImagePoseEstimator | None = None

    def __post_init__(self) -> None:
        require_one_sighting(
            image=bool(self.images),
            camera=self.camera is not None,
            camera_pose=self.camera_pose is not None,
            relative=self.T_r0_r1 is not None,
            relative_sigma=self.relative_sigma is not None,
        )
        require_sigma("relative_sigma", self.relative_sigma or ())


@dataclass(frozen=True, slots=True, kw_only=True)
class Fused:
    """A fusion with all that went into it."""

    request: FuseRequest
    meeting: FusionInput  # maps and poses
    result: FusionResult
    photographs: tuple[Photograph, ...]  # the images, undistorted
    poses: tuple[RelativePose, ...]  # the relative pose estimated from each
    camera: PinholeCamera | None  # the images' camera; None without images
    cuboid_size_m: Vec3  # sides of the robot's cuboid
    weights: dict[str, tuple[str, str]]  # file and SHA-256 of each network used, by name
    seconds: dict[str, float]  # time that each part took
    warnings: tuple[str, ...]  # raised while reading the inputs


@dataclass(slots=True)
class _Clock:
    """Times parts by name."""

    seconds: dict[str, float] = field(default_factory=dict)

    @contextmanager
    def part(self, name: str) -> Iterator[None]:
        start = time.perf_counter()
        yield
        self.seconds[name] = self.seconds.get(name, 0.0) + time.perf_counter() - start


def fused(request: FuseRequest) -> Fused:
    """Fuse two maps.

    Raises:
        MapError, CameraError, ConfigError, StoreError: an input cannot be read or used.
        SightingError: the robot is not found in any image.
        SetupError: PyTorch is needed but not installed.
    """
    clock = _Clock()
    with warnings.catch_warnings(record=True) as caught, clock.part("read"):
        warnings.simplefilter("always")
        _warn_of_degrees(request)
        grid_0, grid_1 = (read_map(given, strict=request.strict) for given in request.maps)
        camera = read_camera(request.camera) if request.camera is not None and request.images else None
        photographs = tuple(
            read_photograph(given, camera, number=number)
            for number, given in enumerate(request.images)
            if camera is not None
        )
        robot = load_robot(request.robot)
        T_r0_c = mounting(request.camera_pose, request.robot)
    meeting = FusionInput(grid_0=grid_0, grid_1=grid_1, T_m0_r0=request.T_m0_r0, T_m1_r1=request.T_m1_r1)
    with clock.part("load"):
        matcher = _matcher(request.refine)
        refiner = _refiner(request.refine, matcher)
        pose_weights = PoseWeights.found(None) if photographs and request.pose_estimator is None else None
        estimator = _pose_estimator(request, robot, pose_weights) if photographs else None
    poses = tuple[RelativePose, ...]()
    if camera is not None and estimator is not None:
        with clock.part("see"):
            poses = tuple(estimator(shot.image, camera.camera, T_r0_c) for shot in photographs)
    sighting = _sighting(request, poses)
    result = fuse_maps(meeting, sighting, refiner, merge=request.merge, part=clock.part)
    return Fused(
        request=request,
        meeting=meeting,
        result=result,
        photographs=photographs,
        poses=poses,
        camera=camera.camera if camera else None,
        cuboid_size_m=robot.cuboid.size_m,
        weights=_used(matcher, pose_weights),
        seconds=clock.seconds,
        warnings=tuple(str(w.message) for w in caught),
    )


def _warn_of_degrees(request: FuseRequest) -> None:
    """Warn of angles beyond a turn: they may be unwrapped, but more often they are degrees."""
    poses = ("pose 0", request.T_m0_r0), ("pose 1", request.T_m1_r1), ("relative pose", request.T_r0_r1)
    angles = [(name, pose.yaw_rad) for name, pose in poses if pose is not None]
    angles += [("camera pose", angle_rad) for angle_rad in (request.camera_pose or ())[3:]]
    for name, angle_rad in angles:
        if abs(angle_rad) > 2.0 * math.pi:
            warnings.warn(
                f"{name}: an angle is {angle_rad:g} rad, more than a turn; radians are meant, and "
                f"{angle_rad:g}° are {math.radians(angle_rad):.4f} rad",
                stacklevel=2,
            )


def _sighting(request: FuseRequest, poses: Sequence[RelativePose]) -> SightedPose:
    if request.T_r0_r1 is None:
        return sighted_pose(poses)
    sigma = request.relative_sigma
    return SightedPose.given(request.T_r0_r1, None if sigma is None else np.diag(np.square(sigma)))


def _pose_estimator(
    request: FuseRequest, robot: RobotSpec, weights: PoseWeights | None
) -> ImagePoseEstimator:
    """The caller's estimator, or the trained one, which knows only the robot it was trained on."""
    if weights is None:
        assert request.pose_estimator is not None
        return request.pose_estimator
    require_known_robot(
        weights.record(),
        robot.cuboid.size_m,
        robot.cuboid.T_r_o(),
        weights=str(weights.path),
        whose=repr(request.robot),
        instead="give the relative pose",
    )
    return weights.estimator(floor=True)


def _refiner(refine: Refinement, matcher: SelectedMethod | None) -> Refiner | None:
    if matcher is None:
        return None if refine is Refinement.NONE else correlative_refiner
    try:
        estimator: Any = trained(matcher, threads=1).estimator
    except SetupError as error:
        raise SetupError(f"{error}; to refine by correlative search, or not at all, does without") from error
    return matcher_refiner(estimator, with_prior=refine is Refinement.AUTO)


def _matcher(refine: Refinement) -> SelectedMethod | None:
    """The matcher and its weights, or None if not needed; the refiner replaces its search range."""
    if not refine.needs_matcher:
        return None
    return selected_matcher()


def _used(matcher: SelectedMethod | None, pose_weights: PoseWeights | None) -> dict[str, tuple[str, str]]:
    """File and SHA-256 of the weights that were used, by network."""
    used = {}
    if pose_weights is not None:
        used["relative_pose"] = str(pose_weights.path), pose_weights.digest
    if matcher is not None:
        used["matcher"] = str(matcher.weights), matcher.weights_digest()
    return used
