"""Images of the published dataset that a robot took, with an estimator's inputs and the truth."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import cv2
import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from rendezvous.errors import StoreError
from rendezvous.evaluation.dataset.sampling import ROW, SHARD, located_columns, rows_at
from rendezvous.evaluation.relative_pose.errors import ImageTruth, as_seen
from rendezvous.geometry.camera import Image, PinholeCamera, se2_from_se3
from rendezvous.geometry.se2 import SE2, Array
from rendezvous.schema import PAIRS, POSES
from rendezvous.seeds import stream
from rendezvous.store.read import StageReader
from rendezvous.store.records import digest_of

PLAUSIBLE, SIGHTING = "plausible", "sighting"
KINDS = (PLAUSIBLE, SIGHTING)
"""Plausible training images, and robot 0's view at each sighting. The `free` training images are left out:
no robot takes them, so there is neither a camera height nor a relative pose on a floor."""

_RENDERERS = {"pyrender": "rasterised", "cycles": "path-traced"}
"""By `render.engine`, which images of version 0.1 do not name."""

_TABLES = {PLAUSIBLE: (POSES, "pose_id"), SIGHTING: (PAIRS, "pair_id")}
_SEEN = (
    *("plan_id", "plan_digest", "visibility", "image", "image_width_px", "image_height_px"),
    *("K", "T_r0_c", "T_c_o", "cuboid_size_m", "T_r1_o", "box_px", "drawn"),
)
_NEEDED = {
    PLAUSIBLE: ("pose_id", "mode", "T_r0_c_true", *_SEEN),
    SIGHTING: ("pair_id", "T_r0_r1_true", *_SEEN),
}


@dataclass(frozen=True, slots=True, kw_only=True)
class SeenImage:
    """One image."""

    truth: ImageTruth
    encoded: bytes = field(repr=False)  # JPEG or PNG
    camera: PinholeCamera
    T_r0_c: Array  # (4, 4) the camera's pose by the robot's file
    cuboid_size_m: tuple[float, float, float]
    T_r1_o: Array  # (4, 4) the pose of robot 1's cuboid on it
    box_px: Array | None  # (4,) the box around its visible pixels; None if there are none
    plan_digest: str
    T_c_o: Array | None = None  # (4, 4) the cuboid's true pose in the camera

    def pixels(self) -> Image:
        """(H, W, 3) uint8 red, green, blue.

        Raises:
            StoreError: the image cannot be decoded.
        """
        image = cv2.imdecode(np.frombuffer(self.encoded, np.uint8), cv2.IMREAD_COLOR)
        if image is None:
            raise StoreError(f"{self.truth.image_id}: its image cannot be decoded; must be JPEG or PNG")
        return np.ascontiguousarray(image[..., ::-1], dtype=np.uint8)


def read_images(
    reader: StageReader, split: str, *, kinds: Sequence[str] = KINDS, count: int | None = None, seed: int = 0
) -> list[SeenImage]:
    """Images of one split, in the order of the tables.

    At most `count`, drawn uniformly: a larger draw contains a smaller one.

    Raises:
        StoreError: there are none, or a file is missing, damaged or lacks a column.
    """
    places = {kind: _places(reader, split, kind) for kind in kinds}
    total = sum(table.num_rows for table in places.values())
    if not total:
        raise StoreError(
            f"{reader.root}: no {' or '.join(kinds)} images of split {split}; must be a dataset whose images "
            "`rendezvous render` took and `rendezvous pack` published"
        )
    drawn = np.sort(stream(seed, "evaluation", "images").permutation(total)[:count])
    images, first = list[SeenImage](), 0
    for kind, table in places.items():
        mine = drawn[(drawn >= first) & (drawn < first + table.num_rows)] - first
        schema, id_column = _TABLES[kind]
        images += [_seen(row, kind, row[id_column]) for row in rows_at(reader, table.take(mine), schema)]
        first += table.num_rows
    return images


def digest_of_images(images: Sequence[SeenImage]) -> str:
    """Digest of the estimators' inputs and of the truth."""
    return digest_of(
        {
            image.truth.image_id: [
                digest_of(image.encoded.hex()),
                image.camera.K().tolist(),
                image.T_r0_c.tolist(),
                image.truth.visibility,
                image.truth.T_r0_r1 and image.truth.T_r0_r1.as_array().tolist(),
            ]
            for image in images
        }
    )


def _places(reader: StageReader, split: str, kind: str) -> pa.Table:
    """The places of one kind's images; no rows if the table or its images are missing."""
    schema, id_column = _TABLES[kind]
    under = f"{schema.name}/{split}-"
    columns = (id_column, "visibility", *(("mode",) if kind == PLAUSIBLE else ()))
    if not reader.shards(under):
        return pa.table({name: [] for name in (*columns, SHARD, ROW)})
    table = located_columns(reader, columns, under=under)
    there = reader.table(reader.shards(under)[0].name).column_names
    for name in _NEEDED[kind]:
        if name not in there:
            raise StoreError(
                f"{reader.root}/{under}*.parquet: has no column {name!r}; must be as `rendezvous pack` "
                "writes it"
            )
    pictured = pc.is_valid(table["visibility"])
    return table.filter(
        pc.and_(pictured, pc.equal(table["mode"], PLAUSIBLE)) if kind == PLAUSIBLE else pictured
    )


def _seen(row: dict[str, Any], kind: str, image_id: str) -> SeenImage:
    T_c_o = row["T_c_o"]
    distance_m, heading_rad = (np.nan, np.nan) if T_c_o is None else as_seen(T_c_o)
    return SeenImage(
        truth=ImageTruth(
            image_id=image_id,
            plan_id=row["plan_id"],
            kind=kind,
            renderer=_RENDERERS[json.loads(row["drawn"]).get("engine", "pyrender")],
            visibility=float(row["visibility"]),
            T_r0_r1=_true_pose(row, kind),
            distance_m=distance_m,
            heading_rad=heading_rad,
        ),
        encoded=row["image"],
        camera=PinholeCamera.of_matrix(row["K"], row["image_width_px"], row["image_height_px"]),
        T_r0_c=row["T_r0_c"],
        cuboid_size_m=(*(float(side) for side in row["cuboid_size_m"]),),  # type: ignore[arg-type]
        T_r1_o=row["T_r1_o"],
        box_px=row["box_px"],
        plan_digest=row["plan_digest"],
        T_c_o=T_c_o,
    )


def _true_pose(row: dict[str, Any], kind: str) -> SE2 | None:
    """True pose of robot 1 in robot 0; a plausible image has its own true camera pose, a little askew."""
    if row["T_c_o"] is None:
        return None
    if kind == SIGHTING:
        pose: SE2 = row["T_r0_r1_true"]
        return pose
    return se2_from_se3(row["T_r0_c_true"] @ row["T_c_o"] @ np.linalg.inv(row["T_r1_o"]))
