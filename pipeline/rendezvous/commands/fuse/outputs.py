"""Files that `fuse` writes: the fused map for ROS, pictures, and a record.

`fused.yaml` and `fused.pgm` are the map in the frame of map 0, `fused.png` shows how the two maps overlap,
`image.png` (`image_0.png`, ... for several) the robot in the image. `result.json` holds the following, with
lengths in metres, angles in radians, poses as `x_m, y_m, yaw_rad`, and null for what is not known:

- `verdict`: `accepted` or `uncertain`; `reasons`: what speaks against the map.
- `T_m0_m1` (the result, Eq. 3), `T_m0_m1_initial` (from the sighting alone, Eq. 2): pose of map 1 in map 0;
  `T_m1_m0`, `T_m1_m0_initial`: their inverses; `T_m0_r1`: pose of robot 1 in map 0.
- `frame_error`: `theta_w` (w as the paper calls the window): the error of the initial transform seen from C,
  which is `window_centre_m0` [x, y] with the axes of map 0, so that `T_m0_m1 = C theta_w^-1 C^-1
  T_m0_m1_initial`; null if it was not looked for or not found. `covariance`: 3 x 3, of the error that remains
  (`degrees_of_freedom` of its Student's t distribution, null: normal). `ambiguous`: the maps fit in more than
  one way. `refined_by`: the `refine` asked for.
- `sighting`: readings of the sighting, the most probable first: `T_r0_r1`, `covariance` (3 x 3, of
  `T_r0_r1^-1 T_true`) with `degrees_of_freedom`, `mass` (probability), `images` it rests on. `images`: for
  each its `name`, whether the robot was `found`, `score`, the `reason` if not, and the `modes` it may have.
- `overlap`: cells known in both maps / in either. `agreement_before`, `agreement_after` the refinement:
  `compared_m`, the length of either map's walls where the other is known, `wall_share` of it that coincides
  with walls and `conflict_share` that lies on floor there.
- `seconds` per part, `inputs` as given (sigmas and camera pose in metres and radians), `weights` of the
  networks used (`file`, `sha256`), `warnings`, `files` beside the record, `versions` of packages.
"""

from __future__ import annotations

import json
import math
import re
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np

from rendezvous.commands.fuse.fuse import Fused, FuseRequest
from rendezvous.errors import ConfigError
from rendezvous.evaluation.pictures.canvas import encoded_png
from rendezvous.evaluation.pictures.fusion import fusion_picture, sighting_picture
from rendezvous.fusion.fusion_input import SightedMode
from rendezvous.fusion.system import FusionResult
from rendezvous.fusion.verdict import MapAgreement, spread_of
from rendezvous.geometry.se2 import SE2
from rendezvous.interop.ros_map import map_image_path, ros_map_bytes
from rendezvous.pose_estimation.pose_estimate import PoseMode, RelativePose
from rendezvous.store.disk import Disk
from rendezvous.store.records import json_bytes

_MAP, _MAP_IMAGE, _PICTURE, _RECORD = "fused.yaml", "fused.pgm", "fused.png", "result.json"
_PHOTOGRAPH = re.compile(r"image(_\d+)?\.png")
_PACKAGES = ("rendezvous-fusion", "numpy", "opencv-python-headless", "torch")


def write_fused(fused: Fused, out: Path) -> list[Path]:
    """Write a fusion to a folder, `result.json` last, replacing that of an earlier fusion.

    All files get temporary names first, so that a full disk leaves the earlier fusion intact; beside a record
    there are only files of the same fusion.

    Returns:
        The files.

    Raises:
        ConfigError: a file would replace one of the inputs.
        StoreError: the folder cannot be written.
    """
    require_apart(fused.request, out)
    image, header = ros_map_bytes(fused.result.grid, _MAP_IMAGE)
    picture = encoded_png(fusion_picture(fused.meeting, fused.result))
    files = {_MAP_IMAGE: image, _MAP: header, _PICTURE: picture}
    files |= _sighting_files(fused)
    files[_RECORD] = json_bytes(_plain(record_of(fused, sorted(files))))
    disk = Disk(str(out))
    try:
        for name, data in files.items():
            disk.write(_staged(name), data)
        for name in (*_earlier_pictures(disk), _RECORD):
            _remove(disk, name)
        for name in files:
            disk.move(_staged(name), name)
    except BaseException:
        for name in files:
            _remove(disk, _staged(name))
        raise
    return [out / name for name in files]


def require_apart(request: FuseRequest, out: Path) -> None:
    """Check that no output would overwrite an input.

    Raises:
        ConfigError: names the input.
        MapError: the YAML file of a map cannot be read.
    """
    folder = Path(Disk(str(out)).path()).resolve()
    map_images = [map_image_path(Path(given)) for given in request.maps if isinstance(given, str | Path)]
    for given in (*request.maps, *map_images, *request.images, request.camera):
        if isinstance(given, str | Path) and _is_output(Path(given), folder):
            raise ConfigError(f"{given}: would be overwritten; must not be named so in --out {str(out)!r}")


def _is_output(path: Path, folder: Path) -> bool:
    try:
        path = path.resolve()
    except ValueError:  # a zero byte or half a character: no file can have that name
        return False
    ours = path.name in (_MAP, _MAP_IMAGE, _PICTURE, _RECORD) or _PHOTOGRAPH.fullmatch(path.name)
    return path.parent == folder and bool(ours)


def _staged(name: str) -> str:
    return f"{name}.new"


def _remove(disk: Disk, name: str) -> None:
    if disk.size(name) is not None:
        disk.remove(name)


def _earlier_pictures(disk: Disk) -> list[str]:
    """Names of an earlier fusion's pictures, from its record: other pictures are not ours."""
    if disk.size(_RECORD) is None:
        return []
    try:
        names = json.loads(disk.read(_RECORD))["files"]
        return [name for name in names if _PHOTOGRAPH.fullmatch(name)]
    except (ValueError, KeyError, TypeError):  # no record of a fusion
        return []


def record_of(fused: Fused, files: list[str]) -> dict[str, Any]:
    """Content of `result.json`.

    Args:
        fused: the fusion.
        files: names of the files beside it.
    """
    result = fused.result
    return {
        "verdict": "accepted" if result.verdict.accepted else "uncertain",
        "reasons": result.verdict.reasons,
        "T_m0_m1": _pose(result.T_m0_m1),
        "T_m1_m0": _pose(result.T_m0_m1.inverse()),
        "T_m0_m1_initial": _pose(result.T_m0_m1_initial),
        "T_m1_m0_initial": _pose(result.T_m0_m1_initial.inverse()),
        "T_m0_r1": _pose(result.T_m0_m1 @ fused.meeting.T_m1_r1),
        "frame_error": _frame_error(fused),
        "sighting": [{**_mode(mode), "images": mode.images} for mode in result.sighting.modes],
        "images": [
            _image(shot.name, pose) for shot, pose in zip(fused.photographs, fused.poses, strict=True)
        ],
        "overlap": result.overlap,
        "agreement_before": _agreement(result.before),
        "agreement_after": _agreement(result.after),
        "seconds": {name: round(value, 4) for name, value in fused.seconds.items()},
        "inputs": _inputs(fused),
        "weights": {name: {"file": file, "sha256": sha} for name, (file, sha) in fused.weights.items()},
        "warnings": fused.warnings,
        "files": files,
        "versions": {name: metadata.version(name) for name in _PACKAGES if _installed(name)},
    }


def summary(result: FusionResult, out: Path) -> str:
    """Verdict, pose, agreement and times of a fusion that was written to a folder, a line each."""
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
    seconds = json.loads((out / _RECORD).read_bytes())["seconds"]
    lines.append("seconds: " + ", ".join(f"{name} {value:.2f}" for name, value in seconds.items()))
    lines.append(f"{out / _MAP}, {out / _PICTURE}, {out / _RECORD}")
    return "\n".join(lines)


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
    """Frame error of the initial alignment and the covariance of what is left after its correction."""
    result, estimate = fused.result, fused.result.estimate
    theta = estimate.theta if estimate else None
    return {
        "window_centre_m0": [result.T_m0_v.x_m, result.T_m0_v.y_m],
        "theta_w": None if theta is None else _pose(theta),
        "covariance": result.covariance,
        "covariance_is_of": "x [m], y [m], yaw [rad] of the frame error that is left, at the centre",
        "degrees_of_freedom": _tails(result.degrees_of_freedom),
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
        "camera_pose": request.camera_pose,
        "robot": request.robot,
        "T_r0_r1": None if request.T_r0_r1 is None else _pose(request.T_r0_r1),
        "relative_sigma": request.relative_sigma,
        "refine": str(request.refine),
        "merge": str(request.merge),
        "strict": request.strict,
    }


def _image(name: str, pose: RelativePose) -> dict[str, Any]:
    return {
        "name": name,
        "found": pose.found,
        "score": pose.score,
        "reason": pose.reason,
        "modes": [_mode(mode) for mode in pose.modes],
    }


def _mode(mode: PoseMode | SightedMode) -> dict[str, Any]:
    return {
        "T_r0_r1": _pose(mode.T_r0_r1),
        "covariance": mode.covariance,
        "degrees_of_freedom": _tails(mode.degrees_of_freedom),
        "mass": mode.mass,
    }


def _tails(degrees_of_freedom: float) -> float | None:
    return degrees_of_freedom if math.isfinite(degrees_of_freedom) else None


def _agreement(agreement: MapAgreement) -> dict[str, Any]:
    return {
        "compared_m": agreement.compared_m,
        "wall_share": agreement.wall_share,
        "conflict_share": agreement.conflict_share,
    }


def _plain(value: Any) -> Any:
    """Replace numpy's numbers and arrays, which callers may give, by Python's numbers and lists."""
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    return value.tolist() if isinstance(value, np.generic | np.ndarray) else value


def _name(given: object) -> str:
    return str(given) if isinstance(given, str | Path) else f"<{type(given).__name__}>"


def _pose(T: SE2) -> dict[str, float]:
    x_m, y_m, yaw_rad = T.wrapped().as_array().tolist()
    return {"x_m": x_m, "y_m": y_m, "yaw_rad": yaw_rad}


def _installed(package: str) -> bool:
    try:
        metadata.version(package)
    except metadata.PackageNotFoundError:
        return False
    return True
