"""Images of the robot with its cuboid's points, read straight from the published shards."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
import pyarrow as pa

from rendezvous.errors import StoreError
from rendezvous.geometry.camera import Image
from rendezvous.geometry.cuboid import Vec3
from rendezvous.geometry.occupancy_grid import Mask
from rendezvous.geometry.se2 import Array
from rendezvous.store.read import StageReader
from rendezvous.training.published_rows import PublishedRows, read_split

KIND = "poses"
_ROBOT = ("robot", "cuboid_size_m", "T_r1_o")
_LABEL = ("projected_cuboid_px", "visibility")
COLUMNS = ("pose_id", "plan_digest", "seed", "mode", "image", *_ROBOT, *_LABEL)


@dataclass(frozen=True, slots=True, kw_only=True)
class SeenRobotKind:
    """The robot that the images show."""

    name: str
    size_m: Vec3  # sides of its cuboid along the axes of o
    T_r1_o: tuple[tuple[float, ...], ...]  # (4, 4) the cuboid's pose on it


@dataclass(frozen=True, slots=True, kw_only=True)
class PoseImage:
    """One image with its labels."""

    pose_id: str
    image: Image
    uv_px: Array  # (9, 2) the cuboid's points in DOPE's order; NaN if absent or behind the camera
    visibility: float


class PoseTable(PublishedRows):
    """The images of one split. They stay compressed (100 kB each) and are decoded on access.

    `visibility` (N,) and `uv_px` (N, 9, 2) are those of `PoseImage`; `plausible` (N,) says whether
    another robot's camera might see it so: on the floor, upright.
    """

    def __init__(self, split: str, table: pa.Table) -> None:
        super().__init__(split, table)
        self.visibility: Array = table["visibility"].to_numpy()
        self.uv_px: Array = np.concatenate([_points(chunk) for chunk in table["projected_cuboid_px"].chunks])
        self.plausible: Mask = np.array(table["mode"].to_pylist()) == "plausible"
        self._pose_ids: list[str] = table["pose_id"].to_pylist()

    def __getitem__(self, index: int) -> PoseImage:
        encoded = self.table["image"][index]["bytes"].as_buffer()
        image = cv2.imdecode(np.frombuffer(encoded, np.uint8), cv2.IMREAD_COLOR_RGB)
        if image is None:
            raise StoreError(
                f"{self._pose_ids[index]}: its {len(encoded)} bytes are no image; `rendezvous pack` makes "
                "its file again"
            )
        return PoseImage(
            pose_id=self._pose_ids[index],
            image=np.asarray(image, np.uint8),
            uv_px=self.uv_px[index],
            visibility=float(self.visibility[index]),
        )

    def showing(self, *, least_visibility: float) -> list[int]:
        """Rows whose robot is to be found: visible enough, and wholly in front of the camera."""
        known = np.isfinite(self.uv_px).all(axis=(1, 2))
        return [int(i) for i in np.nonzero(known & (self.visibility >= max(least_visibility, 1e-9)))[0]]

    def without_robot(self) -> list[int]:
        """Rows in which nothing of a robot is visible."""
        return [int(i) for i in np.nonzero(self.visibility == 0.0)[0]]

    def robot(self) -> SeenRobotKind:
        """The robot in all rows.

        Raises:
            StoreError: there are several.
        """
        rows = self.table.select(_ROBOT).to_pylist()
        kinds = {(row["robot"], tuple(row["cuboid_size_m"].values()), tuple(row["T_r1_o"])) for row in rows}
        if len(kinds) > 1:
            told = json.dumps(sorted({name for name, _, _ in kinds}))
            raise StoreError(
                f"{KIND}/{self.split}: images of {len(kinds)} kinds of robots ({told}, their cuboids and "
                "where these lie); must be of one, as a network knows one cuboid"
            )
        ((name, size_m, pose),) = kinds
        T_r1_o = tuple(pose[i : i + 4] for i in range(0, 16, 4))
        return SeenRobotKind(name=name, size_m=size_m, T_r1_o=T_r1_o)


def read_poses(reader: StageReader, split: str, *, more: Sequence[StageReader] = ()) -> PoseTable:
    """The images of one split of the published dataset, and of others.

    Raises:
        StoreError: a folder holds no such images, or a file is missing or damaged or lacks a column.
    """
    tables = [
        table
        for one in (reader, *more)
        for table in read_split(one, KIND, split, columns=COLUMNS, finite=("visibility", "T_r1_o"))
    ]
    return PoseTable(split, pa.concat_tables([table for table in tables if table.num_rows]))


def _points(column: pa.Array) -> Array:
    """(N, 9, 2) of lists of lists; NaN for null."""
    points = np.full((len(column), 9, 2), np.nan)
    points[column.is_valid().to_numpy(zero_copy_only=False)] = (
        column.flatten().flatten().to_numpy(zero_copy_only=False).reshape(-1, 9, 2)
    )
    return points
