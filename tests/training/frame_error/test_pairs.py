"""Reading pairs back from the published shards."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from rendezvous.errors import StoreError
from rendezvous.geometry.occupancy_grid import overlap
from rendezvous.stages.pack import pack
from rendezvous.store.read import StageReader
from rendezvous.training.frame_error.pairs import PairTable, read_pairs
from rendezvous.training.published_rows import rows_per_split
from tests.synthetic_dataset import ROWS, explored, synthetic_run
from tests.training.conftest import SHARES

BY_ID = {row["pair_id"]: row for rows in ROWS for row in rows}


def reader_of(data: Path, stage: str = "dataset") -> StageReader:
    return StageReader(str(data / stage), "pack")


def test_a_pair_is_what_was_written(pairs: PairTable):
    for pair in (pairs[index] for index in range(len(pairs))):
        row = BY_ID[pair.pair_id]
        assert pair.T_m0_m1 == row["T_m0_m1_local"]
        assert pair.T_m1_r1 == row["T_m1_r1"]
        assert (pair.grid_0.T_m_g, pair.grid_1.T_m_g) == (row["origin_0"], row["origin_1"])
        assert (pair.grid_0.png(), pair.grid_1.png()) == (row["map_0"], row["map_1"])
        assert overlap(pair.grid_0, pair.grid_1, pair.T_m0_m1) == pytest.approx(pair.overlap, abs=1e-12)


def test_the_meeting_point_is_where_robot_0_truly_sees_robot_1(pairs: PairTable):
    row, pair = BY_ID[pairs[0].pair_id], pairs[0]
    seen = row["T_m0_r0"] @ row["T_r0_r1_true"]
    assert np.allclose(pair.T_m0_r1.matrix(), seen.matrix(), atol=1e-9)


def test_splits_share_no_plan_and_are_counted_as_read(published: Path):
    tables = {split: read_pairs(reader_of(published), split) for split in ("train", "validation", "test")}
    assert {split: len(table) for split, table in tables.items()} == rows_per_split(
        reader_of(published), "pairs"
    )
    plans = [set(table.table["plan_id"].to_pylist()) for table in tables.values()]
    assert sum(map(len, plans)) == len(set.union(*plans)) == 10
    assert [len(table.plan_digests()) for table in tables.values()] == [len(p) for p in plans]


def test_shards_without_splits_are_told(published: Path):
    with pytest.raises(StoreError, match=r"no pairs in pairs/train.*5 files without a split in their names"):
        read_pairs(reader_of(published, "explore"), "train")


def test_a_missing_dataset_is_told(tmp_path: Path):
    with pytest.raises(StoreError, match=r"no manifest.json.*run `rendezvous pack` first"):
        read_pairs(reader_of(tmp_path), "train")


def test_a_file_without_a_column_is_told(published: Path, tmp_path: Path):
    shutil.copytree(published / "dataset", tmp_path / "dataset")
    path = next((tmp_path / "dataset" / "pairs").glob("train-*.parquet"))
    pq.write_table(pq.ParquetFile(path).read().drop_columns(["overlap"]), path)
    with pytest.raises(StoreError, match=rf"^{path}: table pairs has no column 'overlap'"):
        read_pairs(reader_of(tmp_path), "train")


def test_the_digest_is_of_the_content_not_of_the_files(published: Path, tmp_path: Path, pairs: PairTable):
    explored(tmp_path)
    pack(synthetic_run(tmp_path, *SHARES, "pack.rows_per_file=1000"))
    again = read_pairs(reader_of(tmp_path), "train")
    assert again.digest() == pairs.digest()
    assert read_pairs(reader_of(tmp_path), "test").digest() != pairs.digest()


@pytest.mark.parametrize("value", [float("nan"), float("inf"), None])
@pytest.mark.parametrize("column", ["T_m0_m1_local", "origin_0", "resolution_m"])
def test_a_pose_that_is_no_number_is_named_with_its_file(
    published: Path, tmp_path: Path, column: str, value: object
):
    shutil.copytree(published, tmp_path / "data")
    path = next((tmp_path / "data" / "dataset" / "pairs").glob("train-*.parquet"))
    table = pq.read_table(path)
    rows = table.column(column).to_pylist()
    rows[0] = [value, 0.0, 0.0] if isinstance(rows[0], list) else value
    index = table.column_names.index(column)
    pq.write_table(table.set_column(index, column, pa.array(rows, table.schema.field(column).type)), path)
    with pytest.raises(StoreError, match=rf"{path.name}: column {column} holds a number that is missing or"):
        read_pairs(reader_of(tmp_path / "data"), "train")
