"""What `fuse` leaves: the fused map for ROS, pictures, and a record of all that was found."""

from __future__ import annotations

import math
import tempfile
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.evaluation.canvas import encoded_png
from pipeline.evaluation.fusion_figures import fusion_picture, sighting_picture
from pipeline.fusion.agreement import MapAgreement
from pipeline.fusion.verdict import spread_of
from pipeline.geometry.occupancy_grid import OccupancyGrid
from pipeline.geometry.se2 import SE2, Array
from pipeline.interop.ros_map import write_ros_map
from pipeline.pose_estimation.relative_pose import RelativePose
from pipeline.stages.fuse import Fused
from pipeline.store.disk import Disk
from pipeline.store.records import json_bytes

_MAP, _PICTURE, _RECORD = "fused.yaml", "fused.png", "result.json"
_PACKAGES = ("rendezvous-fusion", "numpy", "opencv-python-headless", "torch")


def write_fused(fused: Fused, out: Path) -> list[Path]:
    """Write a fusion to a folder, each file wholly or not at all, `result.json` last.

    Pictures of an earlier fusion's images are removed.

    Returns:
        The files.

    Raises:
        StoreError: the folder cannot be written.
    """
    files = _map_files(fused.result.grid)
    files[_PICTURE] = encoded_png(fusion_picture(fused.meeting, fused.result))
    files |= _sighting_files(fused)
    files[_RECORD] = json_bytes(record_of(fused, sorted(files)))
    disk = Disk(str(out))
    for name in disk.names():
        if name == "image.png" or (name.startswith("image_") and name.endswith(".png")):
            disk.remove(name)
    for name, data in files.items():
        disk.write(name, data)
    return [out / name for name in files]


def record_of(fused: Fused, files: list[str]) -> dict[str, Any]:
    """All that was found, for `result.json`.

    Args:
        fused: the fusion.
        files: names of those beside the record.
    """
    result = fused.result
    return {
        "verdict": "accepted" if result.verdict.accepted else "uncertain",
        "reasons": list(result.verdict.reasons),
        "T_m0_m1": _pose(result.T_m0_m1),
        "T_m1_m0": _pose(result.T_m0_m1.inverse()),
        "T_m0_m1_initial": _pose(result.T_m0_m1_initial),
        "T_m1_m0_initial": _pose(result.T_m0_m1_initial.inverse()),
        "T_m0_r1": _pose(result.T_m0_m1 @ fused.meeting.T_m1_r1),
        "frame_error": _frame_error(fused),
        "sighting": [
            {
                "T_r0_r1": _pose(mode.T_r0_r1),
                "covariance": _rows(mode.covariance),
                "mass": mode.mass,
                "images": list(mode.images),
            }
            for mode in result.sighting.modes
        ],
        "images": [
            _image(shot.name, pose) for shot, pose in zip(fused.photographs, fused.poses, strict=True)
        ],
        "overlap": result.overlap,
        "agreement_before": _agreement(result.before),
        "agreement_after": _agreement(result.after),
        "seconds": {name: round(value, 4) for name, value in fused.seconds.items()},
        "inputs": _inputs(fused),
        "warnings": list(fused.warnings),
        "files": files,
        "versions": {name: metadata.version(name) for name in _PACKAGES if _installed(name)},
    }


def summary(fused: Fused, out: Path) -> str:
    """What a user wants to know at once."""
    result = fused.result
    T = result.T_m0_m1
    lines = [
        str(result.verdict),
        f"map 1 lies at x {T.x_m:.3f} m, y {T.y_m:.3f} m, yaw {math.degrees(T.yaw_rad):.2f}° in map 0",
    ]
    if result.covariance is not None:
        position_m, heading_rad = spread_of(result.covariance)
        lines[-1] += f" (±{position_m:.3f} m, ±{math.degrees(heading_rad):.2f}° where the robots met)"
    walls = [a.wall_share for a in (result.before, result.after)]
    if None not in walls:
        lines.append(
            f"overlap {result.overlap:.0%}; shared walls that coincide: {walls[0]:.0%} by the sighting "
            f"alone, {walls[1]:.0%} now"
        )
    spent = ", ".join(f"{name} {value:.2f}" for name, value in fused.seconds.items())
    lines.append(f"seconds: {spent}")
    lines.append(f"{out / _MAP}, {out / _PICTURE}, {out / _RECORD}")
    return "\n".join(lines)


def _map_files(grid: OccupancyGrid) -> dict[str, bytes]:
    """The map's image and its YAML, the image first."""
    with tempfile.TemporaryDirectory() as folder:
        yaml_path = Path(folder) / _MAP
        image_path = write_ros_map(grid, yaml_path)
        return {path.name: path.read_bytes() for path in (image_path, yaml_path)}


def _sighting_files(fused: Fused) -> dict[str, bytes]:
    if fused.camera is None:
        return {}
    several = len(fused.photographs) > 1
    return {
        f"image_{number}.png" if several else "image.png": encoded_png(
            sighting_picture(shot.image, fused.camera, pose, fused.cuboid_size_m)
        )
        for number, (shot, pose) in enumerate(zip(fused.photographs, fused.poses, strict=True))
    }


def _frame_error(fused: Fused) -> dict[str, Any]:
    """Of the initial alignment, in the window frame, and what is left of it."""
    result, estimate = fused.result, fused.result.estimate
    theta = estimate.theta if estimate else None
    nu = estimate.degrees_of_freedom if estimate else math.inf
    return {
        "window_centre_m0": [result.T_m0_w.x_m, result.T_m0_w.y_m],
        "theta_w": None if theta is None else _pose(theta),
        "covariance": _rows(result.covariance),
        "covariance_is_of": "x [m], y [m], yaw [rad] of the frame error that is left, at the centre",
        "degrees_of_freedom": nu if math.isfinite(nu) else None,
        "ambiguous": bool(estimate and estimate.ambiguous),
        "refined_by": str(fused.request.refine),
    }


def _inputs(fused: Fused) -> dict[str, Any]:
    request = fused.request
    return {
        "maps": [_name(given) for given in request.maps],
        "T_m0_r0": _pose(request.T_m0_r0),
        "T_m1_r1": _pose(request.T_m1_r1),
        "images": [_name(given) for given in request.images],
        "camera": None if request.camera is None else _name(request.camera),
        "camera_pose": None if request.camera_pose is None else list(request.camera_pose),
        "robot": request.robot,
        "T_r0_r1": None if request.T_r0_r1 is None else _pose(request.T_r0_r1),
        "relative_sigma": None if request.relative_sigma is None else list(request.relative_sigma),
        "refine": str(request.refine),
        "strict": request.strict,
    }


def _image(name: str, pose: RelativePose) -> dict[str, Any]:
    return {
        "name": name,
        "found": pose.found,
        "score": float(pose.score),
        "reason": pose.reason,
        "modes": [
            {"T_r0_r1": _pose(mode.T_r0_r1), "covariance": _rows(mode.covariance), "mass": float(mode.mass)}
            for mode in pose.modes
        ],
    }


def _agreement(agreement: MapAgreement) -> dict[str, Any]:
    return {
        "wall_share": agreement.wall_share,
        "conflict_share": agreement.conflict_share,
        "compared_cells": agreement.compared,
        "cells_known_in_both": agreement.known_in_both,
    }


def _name(given: object) -> str:
    return str(given) if isinstance(given, str | Path) else f"<{type(given).__name__}>"


def _pose(T: SE2) -> dict[str, float]:
    x_m, y_m, yaw_rad = (float(value) for value in T.wrapped().as_array())
    return {"x_m": x_m, "y_m": y_m, "yaw_rad": yaw_rad}


def _rows(covariance: Array | None) -> list[list[float]] | None:
    return None if covariance is None else np.asarray(covariance, np.float64).tolist()


def _installed(package: str) -> bool:
    try:
        metadata.version(package)
    except metadata.PackageNotFoundError:
        return False
    return True
