"""Read the images of the published dataset with their labels, from its Parquet files alone."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

import cv2
import pyarrow as pa
import pyarrow.parquet as pq

from rendezvous.errors import StoreError
from rendezvous.geometry.se2 import Array
from rendezvous.interop.decoding import decoded
from rendezvous.interop.image_header import PNG_START
from rendezvous.interop.pose_label import PoseLabel, label_of
from rendezvous.schema import PAIRS, POSES
from rendezvous.splits import SPLITS
from rendezvous.store.disk import Disk

_BATCH_ROWS = 64

_FILE = re.compile(r"([a-z]+)/([a-z]+)-(\d{5})-of-(\d{5})\.parquet")
_COLUMNS = (
    *("image", "image_width_px", "image_height_px", "K", "robot", "cuboid_size_m", "T_r1_o"),
    *("T_c_o", "visible_px", "silhouette_px", "box_px"),
)


class ImageTable(StrEnum):
    """The dataset's tables that hold images of a robot."""

    POSES = "poses"
    PAIRS = "pairs"


class Split(StrEnum):
    """Which of the dataset's splits to read."""

    TRAIN = "train"
    VALIDATION = "validation"
    TEST = "test"
    ALL = "all"


_SCHEMAS = {ImageTable.POSES: POSES, ImageTable.PAIRS: PAIRS}
_ID_COLUMNS = {ImageTable.POSES: "pose_id", ImageTable.PAIRS: "pair_id"}


@dataclass(frozen=True, slots=True, kw_only=True)
class LabelledImage:
    """One image of the dataset."""

    name: str  # the row's id
    robot: str  # the kind of robot in the dataset; it may be absent from this image
    T_r1_o: Array  # (4, 4) pose of the cuboid on the robot
    label: PoseLabel  # where the robot is
    encoded: bytes  # the image as JPEG or PNG

    def png(self) -> bytes:
        """The image as PNG: the stored bytes, or the JPEG re-encoded losslessly.

        Raises:
            StoreError: the stored bytes are damaged.
        """
        if self.encoded.startswith(PNG_START):
            return self.encoded
        # OpenCV decodes and encodes blue first, so the order of the channels survives.
        image = decoded(self.encoded, cv2.IMREAD_COLOR)
        if image is None:
            raise StoreError(f"{self.name}: the image is damaged; `rendezvous verify` finds damaged files")
        return bytes(cv2.imencode(".png", image)[1])


@dataclass(frozen=True, slots=True, kw_only=True)
class PublishedSplit:
    """The files of one split of one table."""

    root: str  # the dataset's folder
    # table, split: names of the table and the split.
    table: ImageTable
    split: str
    files: tuple[str, ...]  # names within the folder, in order
    rows: int  # number of rows in all files

    def images(self) -> Iterator[LabelledImage]:
        """The images in the order of the files; a batch is in memory at a time.

        Raises:
            StoreError: a file is damaged or lacks a column, or a row has no image.
        """
        for name in self.files:
            for batch in self._batches(name):
                for row in _SCHEMAS[self.table].rows(pa.Table.from_batches([batch])):
                    yield self._labelled(row)

    def _batches(self, name: str) -> Iterator[pa.RecordBatch]:
        disk = Disk(self.root)
        columns = [_ID_COLUMNS[self.table], *_COLUMNS]
        try:
            with disk.filesystem.open_input_file(disk.path(name)) as source:
                file = pq.ParquetFile(source)
                if missing := [c for c in columns if c not in file.schema_arrow.names]:
                    raise StoreError(
                        f"{disk.shown(name)}: no column {missing[0]!r}; of another version: pack it again"
                    )
                yield from file.iter_batches(batch_size=_BATCH_ROWS, columns=columns)
        except (OSError, pa.ArrowInvalid) as error:
            raise StoreError(_unreadable(disk, name, error)) from error

    def _labelled(self, row: dict[str, Any]) -> LabelledImage:
        name = row[_ID_COLUMNS[self.table]]
        if not row["image"]:
            raise StoreError(
                f"{Disk(self.root).shown(self.table)}: {name} has no image; `rendezvous render` takes them "
                "where render.views is true, then `rendezvous pack` publishes them"
            )
        return LabelledImage(
            name=name, robot=row["robot"], T_r1_o=row["T_r1_o"], label=label_of(row), encoded=row["image"]
        )


def published_splits(root: str, table: ImageTable, split: Split) -> list[PublishedSplit]:
    """Find the files of a split, or of all there are; each has rows.

    Args:
        root: the dataset's folder, a local path or a URI.
        table: one of its tables.
        split: one of its splits, or all.

    Raises:
        StoreError: there is no such dataset, table, split or row, or a file is missing or damaged.
    """
    disk = Disk(root)
    found = [match for name in disk.names() if (match := _FILE.fullmatch(name))]
    if not found:
        raise StoreError(
            f"{root}: no dataset here; must be a folder that `rendezvous pack` writes, such as "
            "data/dataset, with files like poses/train-00000-of-00001.parquet"
        )
    of_table = [match for match in found if match[1] == table]
    if not of_table:
        tables = ", ".join(sorted({match[1] for match in found}))
        raise StoreError(f"{root}: no table {table.value!r}; --table must be one of those there: {tables}")
    there = [name for name in SPLITS if any(match[2] == name for match in of_table)]
    if split is not Split.ALL and split not in there:
        raise StoreError(
            f"{disk.shown(table)}: no split {split.value!r}; --split must be one of those there: "
            f"{', '.join(there)}, or all"
        )
    names = there if split is Split.ALL else [split.value]
    splits = [_split(disk, table, name, [m for m in of_table if m[2] == name]) for name in names]
    if not (splits := [part for part in splits if part.rows]):
        raise StoreError(f"{disk.shown(table)}: no rows in {' and '.join(names)}; there is nothing to export")
    return splits


def _split(disk: Disk, table: ImageTable, split: str, files: list[re.Match[str]]) -> PublishedSplit:
    totals = {int(match[4]) for match in files}
    if len(totals) > 1 or {int(match[3]) for match in files} != set(range(*totals)):
        raise StoreError(
            f"{disk.shown(table)}: {len(files)} files of {split}, by their names of "
            f"{' or '.join(str(total) for total in sorted(totals))}; copy or pack the dataset again"
        )
    names = tuple(sorted(match[0] for match in files))
    rows = sum(_row_count(disk, name) for name in names)
    return PublishedSplit(root=disk.root, table=table, split=split, files=names, rows=rows)


def _row_count(disk: Disk, name: str) -> int:
    try:
        with disk.filesystem.open_input_file(disk.path(name)) as source:
            return int(pq.ParquetFile(source).metadata.num_rows)
    except (OSError, pa.ArrowInvalid) as error:
        raise StoreError(_unreadable(disk, name, error)) from error


def _unreadable(disk: Disk, name: str, error: Exception) -> str:
    return (
        f"{disk.shown(name)}: cannot be read ({' '.join(str(error).split())}); copy or pack the dataset again"
    )
