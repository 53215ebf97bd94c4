"""ROS camera calibrations: a pinhole camera and the distortion of its lens.

Two forms are read: the YAML of `camera_calibration` and `camera_info_manager` (`camera_matrix: {data: ...}`),
and a `sensor_msgs/CameraInfo` message as `ros2 topic echo` prints it (`k`, `d`; `K`, `D` in ROS 1).

Undistorted images keep the same `K`, so zero distortion changes nothing. Images of the topic `image_rect` are
already undistorted and need a calibration without distortion.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import yaml
from numpy.typing import NDArray

from rendezvous.errors import CameraError
from rendezvous.geometry.camera import PinholeCamera
from rendezvous.geometry.se2 import Array
from rendezvous.interop.yaml_fields import number, numbers, read_yaml_fields, short

FISHEYE_MODELS = ("equidistant", "fisheye")
COEFFICIENT_COUNTS = {
    "plumb_bob": (4, 5),
    "rational_polynomial": (4, 5, 8, 12, 14),
    **dict.fromkeys(FISHEYE_MODELS, (4,)),
}
"""Allowed numbers of coefficients per model; an empty list means no distortion."""

_STRAIGHT_MODELS = ("none", "pinhole", "perspective", "brown_conrady", "inverse_brown_conrady", "radtan")
"""What drivers call a lens whose coefficients are all 0; with others, these models are not OpenCV's."""

_PADDED_COUNTS = (5, 8, 12, 14)  # of OpenCV's models: drivers pad the coefficients with zeros

RIGHT = "a camera calibration of ROS (image_width, image_height, camera_matrix, distortion_coefficients)"


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraInfo:
    """A camera and its lens."""

    camera: PinholeCamera  # the pinhole camera; pixel (0, 0) is the centre of the first pixel, as in OpenCV
    distortion_model: str  # `plumb_bob`, `rational_polynomial` or `equidistant` (also called `fisheye`)
    distortion: tuple[float, ...]  # the model's coefficients in OpenCV's order; empty for no distortion

    def undistorted(self, image: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """Undistort an image (H, W) or (H, W, 3); black where the lens saw nothing.

        Raises:
            CameraError: the image's size differs from the calibration's.
        """
        camera = self.camera
        self.require_size(image.shape[1], image.shape[0])
        fisheye = self.distortion_model in FISHEYE_MODELS
        # A fisheye lens distorts even if all its coefficients are 0.
        if not self.distortion or not (fisheye or any(self.distortion)):
            return image.copy()
        K, distortion = camera.K(), np.array(self.distortion)
        if fisheye:
            return np.asarray(cv2.fisheye.undistortImage(image, K, distortion, Knew=K), np.uint8)
        return np.asarray(cv2.undistort(image, K, distortion), np.uint8)

    def require_size(self, width_px: int, height_px: int) -> None:
        """Check an image's size.

        Raises:
            CameraError: it differs from the calibration's.
        """
        camera = self.camera
        if (width_px, height_px) != (camera.width_px, camera.height_px):
            raise CameraError(
                f"image of {width_px} x {height_px} px; the camera is calibrated for {camera.width_px} x "
                f"{camera.height_px} px"
            )


def read_camera_info(path: Path) -> CameraInfo:
    """Read a calibration in either form.

    Raises:
        CameraError: the file is missing or is not a calibration, or a value is wrong; says which.
    """
    fields = read_yaml_fields(path, CameraError, right=RIGHT)
    camera = _camera(fields, path)
    _require_whole_image(fields, camera, path)
    model = fields.get("distortion_model") or "plumb_bob"
    name = re.sub(r"[\s-]+", "_", str(model).strip().lower())
    distortion = _list(fields, ("distortion_coefficients", "d", "D"), path)
    if name in _STRAIGHT_MODELS and not any(distortion):
        name = "plumb_bob"
    counts = COEFFICIENT_COUNTS.get(name)
    if counts is None:
        raise CameraError(
            f"{path}: distortion_model is {short(model)}; must be one of {', '.join(COEFFICIENT_COUNTS)}"
        )
    if len(distortion) in _PADDED_COUNTS and not any(distortion[counts[-1] :]):
        distortion = distortion[: counts[-1]]
    elif name not in FISHEYE_MODELS and len(distortion) not in counts and not any(distortion):
        distortion = []  # as for image_proc, zeros bend nothing, however many there are
    if distortion and len(distortion) not in counts:
        raise CameraError(
            f"{path}: {model} has {len(distortion)} coefficients; must be {' or '.join(map(str, counts))}, "
            "or none"
        )
    return CameraInfo(camera=camera, distortion_model=name, distortion=tuple(distortion))


def write_camera_info(camera: PinholeCamera, path: Path) -> None:
    """Write a camera without distortion in the form of `camera_calibration`."""
    path.write_bytes(camera_info_bytes(camera, path.stem))


def camera_info_bytes(camera: PinholeCamera, name: str) -> bytes:
    """The YAML of a camera without distortion."""
    K = camera.K()
    fields = {
        "image_width": int(camera.width_px),
        "image_height": int(camera.height_px),
        "camera_name": name,
        "camera_matrix": _matrix(K),
        "distortion_model": "plumb_bob",
        "distortion_coefficients": _matrix(np.zeros((1, 5))),
        "rectification_matrix": _matrix(np.eye(3)),
        "projection_matrix": _matrix(np.column_stack([K, np.zeros(3)])),
    }
    return yaml.safe_dump(fields, sort_keys=False, default_flow_style=None, encoding="utf-8")


def _matrix(values: Array) -> dict[str, Any]:
    rows, cols = values.shape
    return {"rows": rows, "cols": cols, "data": values.ravel().tolist()}


def _camera(fields: Mapping[str, Any], path: Path) -> PinholeCamera:
    K = _list(fields, ("camera_matrix", "k", "K"), path)
    if len(K) != 9:
        raise CameraError(f"{path}: the camera matrix has {len(K)} numbers; must be 9, row by row")
    if not any(K):
        raise CameraError(
            f"{path}: the camera matrix is all 0, as drivers write it for a camera that is not calibrated; "
            "calibrate it, with camera_calibration for instance"
        )
    fx_px, skew, cx_px, zero_0, fy_px, cy_px, *last_row = K
    if (skew, zero_0, *last_row) != (0.0, 0.0, 0.0, 0.0, 1.0) or fx_px <= 0.0 or fy_px <= 0.0:
        raise CameraError(
            f"{path}: the camera matrix is {short(K)}; must be [fx, 0, cx, 0, fy, cy, 0, 0, 1] with focal "
            "lengths above 0 px"
        )
    return PinholeCamera(
        fx_px=fx_px,
        fy_px=fy_px,
        cx_px=cx_px,
        cy_px=cy_px,
        width_px=_size(fields, ("image_width", "width"), path),
        height_px=_size(fields, ("image_height", "height"), path),
    )


def _list(fields: Mapping[str, Any], keys: tuple[str, ...], path: Path) -> list[float]:
    """Numbers under the first key present, either a plain list or a matrix's `data`."""
    key = _present(fields, keys, path)
    value = fields[key]
    values = numbers(value.get("data") if isinstance(value, dict) else value)
    if values is None:
        raise CameraError(f"{path}: {key} is {short(value)}; must be a list of numbers")
    return values


def _size(fields: Mapping[str, Any], keys: tuple[str, ...], path: Path) -> int:
    key = _present(fields, keys, path)
    value = fields[key]
    size_px = number(value)
    if size_px is None or size_px < 1 or size_px != round(size_px):
        raise CameraError(f"{path}: {key} is {short(value)}; must be a whole number of pixels above 0")
    return int(size_px)


def _present(fields: Mapping[str, Any], keys: tuple[str, ...], path: Path) -> str:
    for key in keys:
        if key in fields:
            return key
    raise CameraError(f"{path}: no key {' or '.join(repr(key) for key in keys)}; must be {RIGHT}")


def _require_whole_image(fields: Mapping[str, Any], camera: PinholeCamera, path: Path) -> None:
    """Refuse binned images and regions of interest: `K` does not apply to them unchanged."""
    for key in ("binning_x", "binning_y"):
        if fields.get(key) is not None and number(fields[key]) not in (0, 1):
            raise CameraError(f"{path}: {key} is {short(fields[key])}; must be 0 or 1, an image not binned")
    roi = fields.get("roi")
    if not isinstance(roi, dict):
        return
    part = [number(roi.get(key, 0)) for key in ("x_offset", "y_offset", "width", "height")]
    if part not in ([0, 0, 0, 0], [0, 0, camera.width_px, camera.height_px]):
        shown = short([roi.get(key, 0) for key in ("x_offset", "y_offset", "width", "height")])
        raise CameraError(f"{path}: roi is x, y, width, height {shown}; must be 0, or the whole image")
