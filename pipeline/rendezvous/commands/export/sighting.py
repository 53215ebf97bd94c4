"""Write one published sighting as `fuse` reads it: maps of ROS, the image, the camera, and the command."""

from __future__ import annotations

import difflib
import shlex
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pyarrow as pa

from rendezvous.errors import StoreError
from rendezvous.geometry.camera import R_BODY_OPTICAL, PinholeCamera
from rendezvous.geometry.occupancy_grid import grid_from_png
from rendezvous.geometry.se2 import SE2, Array
from rendezvous.interop.camera_info import write_camera_info
from rendezvous.interop.ros_map import write_ros_map
from rendezvous.schema import PAIRS
from rendezvous.store.disk import Disk
from rendezvous.store.read import StageReader
from rendezvous.training.frame_error.pairs import SPLIT_NAMES

_COLUMNS = (
    *("pair_id", "map_0", "map_1", "origin_0", "origin_1", "resolution_m", "T_m0_r0", "T_m1_r1"),
    *("T_r0_r1_true", "K", "image_width_px", "image_height_px", "T_r0_c", "image"),
)
_COMMAND = "command.txt"
WHOLE = 0.95
"""Visibility of a robot that is wholly seen, but for a few pixels."""


def export_sighting(dataset: str, pair_id: str | None, out: Path) -> str:
    """Write `map0.yaml`, `map1.yaml` with their images, `image.png`, `camera.yaml` and `command.txt`.

    A pair without an image gets the true relative pose in its command instead.

    Args:
        dataset: folder that `pack` wrote.
        pair_id: of the sighting; None: in the first file of the test split, or of another if that has none,
            the first one whose image shows the whole robot, or else the first.
        out: folder to write to.

    Returns:
        The command that fuses it.

    Raises:
        StoreError: there is no such dataset or pair, or a file cannot be written.
    """
    row = _row(StageReader(dataset, "pack"), pair_id)
    disk = Disk(str(out))
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for i in (0, 1):
            grid = grid_from_png(row[f"map_{i}"], resolution_m=row["resolution_m"], T_m_g=row[f"origin_{i}"])
            write_ros_map(grid, folder / f"map{i}.yaml")
        if row["image"]:
            camera = PinholeCamera.of_matrix(row["K"], row["image_width_px"], row["image_height_px"])
            write_camera_info(camera, folder / "camera.yaml")
            (folder / "image.png").write_bytes(_png(row))
        command = _command(row, out)
        (folder / _COMMAND).write_text(f"{command}\n")
        for path in sorted(folder.iterdir()):
            disk.write(path.name, path.read_bytes())
    return command


def _row(reader: StageReader, pair_id: str | None) -> Mapping[str, Any]:
    """The pair's row; the test split's pairs come first."""
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
    """The first row whose image shows the whole robot; the first of all if none does."""
    return next((i for i, share in enumerate(table["visibility"].to_pylist()) if (share or 0.0) >= WHOLE), 0)


def _png(row: Mapping[str, Any]) -> bytes:
    """The image without further loss."""
    image = cv2.imdecode(np.frombuffer(row["image"], np.uint8), cv2.IMREAD_COLOR)
    if image is None:
        raise StoreError(
            f"{row['pair_id']}: its image cannot be decoded; `rendezvous verify` finds damaged files"
        )
    return bytes(cv2.imencode(".png", image)[1])


def _command(row: Mapping[str, Any], out: Path) -> str:
    """`rendezvous fuse` with all that the row tells."""
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
    """(6,) x, y, z [m], roll, pitch, yaw [rad] of a camera's body: inverse of `camera_pose`."""
    R = T_r0_c[:3, :3] @ R_BODY_OPTICAL.T
    roll, pitch, yaw = (
        np.arctan2(R[2, 1], R[2, 2]),
        -np.arcsin(np.clip(R[2, 0], -1.0, 1.0)),
        np.arctan2(R[1, 0], R[0, 0]),
    )
    return np.array([*T_r0_c[:3, 3], roll, pitch, yaw])


def _numbers(values: Array) -> str:
    """With commas between them, six digits of each, none beyond the micrometre; no minus before a zero."""
    return ",".join(f"{float(value) + 0.0:.6g}" for value in np.round(values, 6))
