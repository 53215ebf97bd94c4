"""Write one published pair as inputs of `fuse`: ROS maps, the image, the camera, and the command."""

from __future__ import annotations

import difflib
import shlex
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pyarrow as pa
from scipy.spatial.transform import Rotation

from rendezvous.errors import StoreError
from rendezvous.geometry.camera import R_BODY_OPTICAL, PinholeCamera
from rendezvous.geometry.occupancy_grid import grid_from_png
from rendezvous.geometry.se2 import SE2, Array
from rendezvous.interop.camera_info import camera_info_bytes
from rendezvous.interop.decoding import decoded
from rendezvous.interop.ros_map import ros_map_bytes
from rendezvous.schema import PAIRS
from rendezvous.store.disk import Disk
from rendezvous.store.read import StageReader
from rendezvous.training.frame_error.pairs import SPLIT_NAMES

_COLUMNS = (
    *("pair_id", "map_0", "map_1", "origin_0", "origin_1", "resolution_m", "T_m0_r0", "T_m1_r1"),
    *("T_r0_r1_true", "K", "image_width_px", "image_height_px", "T_r0_c", "image"),
)
_COMMAND = "command.txt"
WHOLE = 0.95  # visibility above which a robot counts as completely visible


def export_sighting(dataset: str, pair_id: str | None, out: Path) -> str:
    """Write `map0.yaml`, `map1.yaml` with their images, `image.png`, `camera.yaml` and `command.txt`.

    For a pair without an image, the command has the true relative pose instead.

    Args:
        dataset: folder that `pack` wrote.
        pair_id: the pair; None for the first one that shows the whole robot (or else the first) in the first
            file of the test split (or else of another split).
        out: folder to write to.

    Returns:
        The command that fuses the pair.

    Raises:
        StoreError: there is no such dataset or pair, or a file cannot be written.
    """
    row = _row(StageReader(dataset, "pack"), pair_id)
    command = _command(row, out)
    files = {_COMMAND: f"{command}\n".encode(errors="surrogateescape")}
    for i in (0, 1):
        grid = grid_from_png(row[f"map_{i}"], resolution_m=row["resolution_m"], T_m_g=row[f"origin_{i}"])
        files[f"map{i}.pgm"], files[f"map{i}.yaml"] = ros_map_bytes(grid, f"map{i}.pgm")
    if row["image"]:
        camera = PinholeCamera.of_matrix(row["K"], row["image_width_px"], row["image_height_px"])
        files |= {"camera.yaml": camera_info_bytes(camera, "camera"), "image.png": _png(row)}
    disk = Disk(str(out))
    for name, content in sorted(files.items()):
        disk.write(name, content)
    return command


def _row(reader: StageReader, pair_id: str | None) -> Mapping[str, Any]:
    """The pair's row, looked for in the test split first."""
    names = sorted(
        (shard.name for shard in reader.shards() if shard.name.startswith("pairs/")),
        key=lambda name: (
            -next((i for i, split in enumerate(SPLIT_NAMES) if f"/{split}-" in name), -1),
            name,
        ),
    )
    known: list[str] = []
    for name in names:
        table = reader.table(name, columns=("pair_id", "visibility"))
        pair_ids: list[str] = table["pair_id"].to_pylist()
        known += pair_ids
        if pair_ids and (pair_id is None or pair_id in pair_ids):
            index = _best_seen(table) if pair_id is None else pair_ids.index(pair_id)
            return PAIRS.rows(reader.table(name, columns=_COLUMNS).slice(index, 1))[0]
    if not known:
        raise StoreError(f"{reader.root}: holds no pairs; must be a dataset that `rendezvous pack` published")
    near = difflib.get_close_matches(pair_id or "", known, n=3) or known[:3]
    raise StoreError(f"{reader.root}: no pair {pair_id!r}; there are {', '.join(near)}, ...")


def _best_seen(table: pa.Table) -> int:
    """Index of the first row whose image shows the whole robot, or 0."""
    return next((i for i, share in enumerate(table["visibility"].to_pylist()) if (share or 0.0) >= WHOLE), 0)


def _png(row: Mapping[str, Any]) -> bytes:
    """The image, re-encoded losslessly."""
    image = decoded(row["image"], cv2.IMREAD_COLOR)
    if image is None:
        raise StoreError(
            f"{row['pair_id']}: its image cannot be decoded; `rendezvous verify` finds damaged files"
        )
    return bytes(cv2.imencode(".png", image)[1])


def _command(row: Mapping[str, Any], out: Path) -> str:
    """`rendezvous fuse` with the row's poses."""
    words = ["rendezvous", "fuse"]
    for i in (0, 1):
        words += [
            f"--map{i}",
            str(out / f"map{i}.yaml"),
            f"--pose{i}={_numbers(row[f'T_m{i}_r{i}'].as_array())}",
        ]
    if row["image"]:
        words += ["--image", str(out / "image.png"), "--camera", str(out / "camera.yaml")]
        words.append(f"--camera-pose={_numbers(_body_pose(row['T_r0_c']))}")
    else:
        true: SE2 = row["T_r0_r1_true"]
        words.append(f"--relative={_numbers(true.wrapped().as_array())}")
    return shlex.join([*words, "--out", str(out / "fused")])


def _body_pose(T_r0_c: Array) -> Array:
    """(6,) x, y, z [m], roll, pitch, yaw [rad] of a camera's body, the inverse of `camera_pose`."""
    yaw_pitch_roll = Rotation.from_matrix(T_r0_c[:3, :3] @ R_BODY_OPTICAL.T).as_euler("ZYX")
    return np.array([*T_r0_c[:3, 3], *yaw_pitch_roll[::-1]])


def _numbers(values: Array) -> str:
    """Comma-separated, with six significant digits down to the micrometre, and never `-0`."""
    return ",".join(f"{float(value) + 0.0:.6g}" for value in np.round(values, 6))
