"""Reads the inputs of `fuse`."""

from __future__ import annotations

import re
import warnings
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np

from rendezvous.errors import CameraError, ConfigError, MapError
from rendezvous.geometry.camera import Image, PinholeCamera, camera_pose
from rendezvous.geometry.occupancy_grid import FREE, OCCUPIED, UNKNOWN, OccupancyGrid
from rendezvous.geometry.se2 import SE2, Array
from rendezvous.interop.camera_info import CameraInfo, read_camera_info
from rendezvous.interop.decoding import decoded, is_whole
from rendezvous.interop.given_file import given_bytes
from rendezvous.interop.image_header import MAX_PIXELS, TIFF_STARTS, image_header
from rendezvous.interop.ros_map import read_ros_map
from rendezvous.robot_file import load_robot

MapLike = str | Path | OccupancyGrid
ImageLike = str | Path | Image
CameraLike = str | Path | CameraInfo | PinholeCamera

FOCAL_SHARES = 0.1, 20.0  # focal lengths of real lenses / the image's side: fields of view from 157° to 3°


@dataclass(frozen=True, slots=True, kw_only=True)
class Photograph:
    """An undistorted image."""

    name: str  # for messages and records
    image: Image  # (H, W, 3) uint8 RGB


def read_map(given: MapLike, *, strict: bool) -> OccupancyGrid:
    """The ROS map in a file, or the grid itself.

    Raises:
        MapError: the file is missing or is not a map, or the grid has values that map_server has not.
    """
    if isinstance(given, OccupancyGrid):
        others = given.cells[~np.isin(given.cells, (OCCUPIED, UNKNOWN, FREE))]
        if others.size:
            raise MapError(
                f"a map is given with {others.size} cells of other values, as {others[0]}; must be "
                f"{OCCUPIED} occupied, {UNKNOWN} unknown, {FREE} free"
            )
        return replace(given, T_m_g=SE2.from_array(given.T_m_g.as_array()))
    if not isinstance(given, str | Path):
        raise MapError(f"a map is given as {type(given).__name__}; must be its YAML file or an OccupancyGrid")
    return read_ros_map(Path(given), strict=strict)


def read_camera(given: CameraLike) -> CameraInfo:
    """The ROS calibration in a file, or the camera itself; a pinhole camera has no distortion.

    Raises:
        CameraError: the file is missing or is not a calibration, or no real lens has its focal lengths.
    """
    info = _camera_info(given)
    camera = info.camera
    for axis, focal_px, side_px in (
        ("fx", camera.fx_px, camera.width_px),
        ("fy", camera.fy_px, camera.height_px),
    ):
        low_px, high_px = (share * side_px for share in FOCAL_SHARES)
        if not low_px <= focal_px <= high_px:
            name = given if isinstance(given, str | Path) else "camera"
            raise CameraError(
                f"{name}: {axis} is {focal_px:g} px for an image of {side_px} px; must be from {low_px:g} to "
                f"{high_px:g} px"
            )
    return info


def _camera_info(given: CameraLike) -> CameraInfo:
    if isinstance(given, CameraInfo):
        return given
    if isinstance(given, PinholeCamera):
        return CameraInfo(camera=given, distortion_model="plumb_bob", distortion=())
    if not isinstance(given, str | Path):
        raise CameraError(
            f"the camera is given as {type(given).__name__}; must be its camera_info file, a CameraInfo or a "
            "PinholeCamera"
        )
    return read_camera_info(Path(given))


def read_photograph(given: ImageLike, camera: CameraInfo, *, number: int) -> Photograph:
    """Read an image and undistort it.

    Args:
        given: a file that OpenCV reads, or (H, W, 3) uint8 RGB.
        camera: the camera that took it.
        number: the image's number, for messages about an array.

    Raises:
        CameraError: it is neither a file nor an array, not an image, truncated, or not of the camera's size.
    """
    if isinstance(given, np.ndarray):
        name, image = f"image {number}", given
        if image.ndim != 3 or image.shape[2] != 3 or image.dtype != np.uint8:
            raise CameraError(f"{name}: shape {image.shape}, {image.dtype}; must be (H, W, 3) uint8 RGB")
    elif isinstance(given, str | Path):
        name, image = str(given), _decoded(Path(given), camera)
    else:
        raise CameraError(
            f"image {number} is given as {type(given).__name__}; must be its file or (H, W, 3) uint8 RGB"
        )
    try:
        return Photograph(name=name, image=np.ascontiguousarray(camera.undistorted(image)))
    except CameraError as error:
        raise CameraError(f"{name}: {error}") from error


def _decoded(path: Path, camera: CameraInfo) -> Image:
    try:
        data = given_bytes(path)
    except OSError as error:
        raise CameraError(f"{path}: {(error.strerror or str(error)).lower()}; must be an image") from error
    header = image_header(data)
    if header is not None and header.fits:  # checked before memory is taken for its pixels
        try:
            camera.require_size(header.width, header.height)
        except CameraError as error:
            raise CameraError(f"{path}: {error}") from error
    if not is_whole(data):
        raise CameraError(
            f"{path}: the image is damaged, or cut short after {len(data)} bytes; copy it again"
        )
    image = decoded(data, cv2.IMREAD_COLOR_RGB | cv2.IMREAD_IGNORE_ORIENTATION)
    if image is None:
        raise CameraError(
            f"{path}: {len(data)} bytes that are no image; must be PNG, JPEG, BMP, TIFF, WebP or PPM "
            f"of at most {MAX_PIXELS:,} pixels"
        )
    may_be_turned = data.startswith(TIFF_STARTS) or re.search(rb"(?i)exif", data)
    turned = decoded(data, cv2.IMREAD_COLOR_RGB) if may_be_turned else image
    if not np.array_equal(turned, image):  # type: ignore[arg-type]
        warnings.warn(
            f"{path}: has an EXIF orientation, by which viewers turn it; it is read as it is stored, as the "
            "camera is calibrated for that",
            stacklevel=4,
        )
    return np.asarray(image, np.uint8)


def mounting(camera_pose_xyzrpy: tuple[float, ...] | None, robot: str) -> Array:
    """(4, 4) T_r0_c, pose of the camera's optical frame on robot 0.

    Args:
        camera_pose_xyzrpy: x, y, z [m], roll, pitch, yaw [rad] of the camera's body (x forward) on the robot;
            None for the pose in the robot's file.
        robot: a shipped robot or a robot file.

    Raises:
        ConfigError: there is no such robot, or the pose is not six finite numbers.
    """
    if camera_pose_xyzrpy is None:
        return load_robot(robot).camera.T_r_c()
    values = np.array(camera_pose_xyzrpy, np.float64)
    if values.shape != (6,) or not np.isfinite(values).all():
        raise ConfigError(
            f"camera pose is {camera_pose_xyzrpy}; must be six finite numbers, "
            "x, y, z [m], roll, pitch, yaw [rad]"
        )
    return camera_pose(values[:3], values[3:])
