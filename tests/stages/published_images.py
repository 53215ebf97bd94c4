"""A published dataset of a few images: labels of a Burger at random poses over images of one grey each."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pyarrow.parquet as pq
from typer.testing import CliRunner

from rendezvous.cli.__main__ import app
from rendezvous.commands.export.image_folder import BATCH_IMAGES
from rendezvous.geometry.cuboid import project_cuboid
from rendezvous.robot_file import load_robot
from rendezvous.schema import PAIRS, POSES, TableSchema
from tests.geometry.test_cuboid import random_pose
from tests.synthetic import synthetic_row

BURGER = load_robot("burger")
CAMERA = BURGER.camera.intrinsics()

FIRST_FILE = BATCH_IMAGES + 6
ROWS = FIRST_FILE + 10

ABSENT, HIDDEN = 3, 5
"""Rows with these numbers, counted in each ten, show no robot and one that is wholly covered."""


def grey(number: int) -> int:
    """What the image of a row is filled with."""
    return 10 + number % 200


def encoded(number: int, suffix: str = ".jpg") -> bytes:
    image = np.full((CAMERA.height_px, CAMERA.width_px, 3), grey(number), np.uint8)
    return bytes(cv2.imencode(suffix, image)[1])


def label_columns(number: int) -> dict[str, Any]:
    """What `render` knows of a row: pose, pixels, box."""
    if number % 10 == ABSENT:
        return {"visibility": 0.0, "visible_px": 0, "silhouette_px": 0}
    T_c_o = random_pose(np.random.default_rng(number))
    uv_px = project_cuboid(T_c_o, BURGER.cuboid.size_m, CAMERA)
    visible_px = 0 if number % 10 == HIDDEN else 100 + 50 * (number % 10)
    return {
        "T_c_o": T_c_o,
        "projected_cuboid_px": uv_px,
        "visibility": visible_px / 2000,
        "visible_px": visible_px,
        "silhouette_px": 2000,
        "box_px": [9.5, 19.5, 29.5, 22.5] if visible_px else None,
    }


def seen_robot() -> dict[str, Any]:
    return {
        "image_width_px": CAMERA.width_px,
        "image_height_px": CAMERA.height_px,
        "K": CAMERA.K(),
        "robot": "burger",
        "cuboid_size_m": BURGER.cuboid.size_m,
        "T_r1_o": BURGER.cuboid.T_r_o(),
        "drawn": "{}",
    }


def pose_row(number: int, **changes: Any) -> dict[str, Any]:
    row = {
        "pose_id": f"plan-p{number:03d}",
        "plan_id": "plan",
        "plan_digest": "0",
        "seed": 0,
        "mode": "free",
        "image": encoded(number),
    }
    return row | seen_robot() | label_columns(number) | changes


def pair_row(number: int, **changes: Any) -> dict[str, Any]:
    return (
        _sighting()
        | {"pair_id": f"pair-{number}"}
        | seen_robot()
        | {"image": encoded(number)}
        | label_columns(number)
        | changes
    )


@cache
def _sighting() -> dict[str, Any]:
    row = synthetic_row(np.random.default_rng(0))
    return {name: value for name, value in row.items() if name != "furniture"}


def publish(
    folder: Path, split: str, files: Sequence[Sequence[dict[str, Any]]], *, schema: TableSchema = POSES
) -> None:
    """Write a split's files as `pack` names them."""
    (folder / schema.name).mkdir(parents=True, exist_ok=True)
    for number, rows in enumerate(files):
        name = f"{split}-{number:05d}-of-{len(files):05d}.parquet"
        pq.write_table(schema.table(rows), folder / schema.name / name)


def publish_views_off(folder: Path) -> None:
    """Pairs as they are without their images."""
    rows = [pair_row(0) | {"image": None, "visible_px": None, "silhouette_px": None, "visibility": None}]
    publish(folder, "train", [rows], schema=PAIRS)


def publish_all(folder: Path) -> None:
    """80 training images in two files, 6 and 10 of the other splits, and 4 pairs."""
    rows = [pose_row(i) for i in range(ROWS)]
    publish(folder, "train", [rows[:FIRST_FILE], rows[FIRST_FILE:]])
    publish(folder, "validation", [rows[:6]])
    publish(folder, "test", [rows[:10]])
    publish(folder, "train", [[pair_row(i) for i in range(4)]], schema=PAIRS)


def rendezvous(*arguments: object) -> tuple[int, str, str]:
    """Exit code, output and error output of a command."""
    result = CliRunner().invoke(app, ["export", *(str(a) for a in arguments)])
    if result.exception and not isinstance(result.exception, SystemExit):
        raise result.exception
    return result.exit_code, result.stdout, result.stderr


def exported(*arguments: object) -> str:
    """Output of a command that must succeed."""
    code, told, faults = rendezvous(*arguments)
    assert code == 0, faults
    return told


def corners_cm(width: float, height: float, depth: float) -> np.ndarray:
    """(9, 3) of DOPE's Cuboid3d: x to the right, y down, z to the front; front first, then the centre."""
    x, y, z = width / 2, height / 2, depth / 2
    front = [[x, -y, z], [-x, -y, z], [-x, y, z], [x, y, z]]
    rear = [[x, -y, -z], [-x, -y, -z], [-x, y, -z], [x, y, -z]]
    return np.array([*front, *rear, [0, 0, 0]])


def files(folder: Path) -> list[str]:
    return sorted(str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file())
