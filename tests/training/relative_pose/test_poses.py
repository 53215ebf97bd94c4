"""Images of the robot as training reads them."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pyarrow as pa
import pytest

from rendezvous.errors import StoreError
from rendezvous.store.read import StageReader
from rendezvous.training.published_rows import rows_per_split
from rendezvous.training.relative_pose.poses import COLUMNS, PoseTable, SeenRobotKind, read_poses
from tests.synthetic_dataset import POSE_ROWS

ROWS = {row["pose_id"]: row for rows in POSE_ROWS for row in rows}


def reader_of(published: Path, stage: str = "dataset") -> StageReader:
    return StageReader(str(published / stage), "pack")


def edited(poses: PoseTable, column: str, values: list) -> PoseTable:
    index = poses.table.column_names.index(column)
    kind = poses.table.schema.field(column).type
    return PoseTable(
        "train", poses.table.set_column(index, column, pa.chunked_array([pa.array(values, kind)]))
    )


def test_rows_are_those_that_were_published(published: Path):
    tables = {split: read_poses(reader_of(published), split) for split in ("train", "validation", "test")}
    assert {split: len(table) for split, table in tables.items()} == rows_per_split(
        reader_of(published), "poses"
    )
    found = [table[i] for table in tables.values() for i in range(len(table))]
    assert sorted(pose.pose_id for pose in found) == sorted(ROWS)
    for pose in found:
        row = ROWS[pose.pose_id]
        pixels = cv2.imdecode(np.frombuffer(row["image"], np.uint8), cv2.IMREAD_COLOR)[..., ::-1]
        assert np.array_equal(pose.image, pixels)
        assert pose.visibility == row["visibility"]
        absent = row["projected_cuboid_px"] is None
        assert (
            np.isnan(pose.uv_px).all() if absent else np.array_equal(pose.uv_px, row["projected_cuboid_px"])
        )


def test_images_that_show_too_little_of_the_robot_are_neither_with_nor_without_it(poses: PoseTable):
    half = float(np.median(poses.visibility))
    showing, without = poses.showing(least_visibility=half), poses.without_robot()
    assert {poses.visibility[i] >= half for i in showing} == {True}
    assert {poses.visibility[i] for i in without} == {0.0}
    assert 0 < len(showing) + len(without) < len(poses)
    assert set(showing) | set(without) < set(poses.showing(least_visibility=0.0)) | set(without)


def test_the_robot_is_told_as_the_rows_have_it(poses: PoseTable):
    T_r1_o = tuple(tuple(row) for row in np.eye(4).tolist())
    assert poses.robot() == SeenRobotKind(name="scout", size_m=(0.3, 0.2, 0.1), T_r1_o=T_r1_o)


def test_images_of_several_robots_are_told(poses: PoseTable):
    names = ["scout"] * (len(poses) - 1) + ["burger"]
    with pytest.raises(StoreError, match=r"images of 2 kinds of robots \(\[\"burger\", \"scout\"\]"):
        edited(poses, "robot", names).robot()


def test_bytes_that_are_no_image_are_told(poses: PoseTable):
    damaged = edited(poses, "image", [{"bytes": b"\xff\xd8 cut off", "path": None}] * len(poses))
    with pytest.raises(StoreError, match=r"^plan-\d+-p\d+: its 10 bytes are no image"):
        damaged[0]


def test_a_dataset_without_such_images_is_told(published: Path):
    with pytest.raises(
        StoreError, match=r"no poses in poses/train-\*.parquet, found \d+ files without a split"
    ):
        read_poses(reader_of(published, "explore"), "train")


def test_a_file_without_a_column_is_told(published: Path, tmp_path: Path):
    import shutil

    import pyarrow.parquet as pq

    shutil.copytree(published / "dataset", tmp_path / "dataset")
    path = next((tmp_path / "dataset" / "poses").glob("train-*.parquet"))
    pq.write_table(pq.read_table(path).drop_columns(["visibility"]), path)
    with pytest.raises(StoreError, match=r"train-.*: table poses has no column 'visibility'"):
        read_poses(reader_of(tmp_path), "train")


def test_the_digest_is_of_the_content(poses: PoseTable):
    halves = [poses.table.slice(0, 2), poses.table.slice(2)]
    assert PoseTable("train", pa.concat_tables(halves)).digest() == poses.digest()
    assert edited(poses, "seed", [1] * len(poses)).digest() != poses.digest()
    assert tuple(poses.table.column_names) == COLUMNS


def test_images_of_other_datasets_are_added(published):
    reader = reader_of(published)
    once, twice = read_poses(reader, "train"), read_poses(reader, "train", more=[reader])
    assert len(twice) == 2 * len(once)
    assert (twice[len(once)].image == once[0].image).all()
