"""Pack, on sightings and images drawn instead of driven and rendered."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from rendezvous.engine.run import part_name
from rendezvous.errors import SplitError, StoreError
from rendezvous.schema import PAIRS, POSES, VIEWS
from rendezvous.splits import SPLITS
from rendezvous.stages.pack import LAYOUT, pack
from rendezvous.store.write import StageWriter
from tests.synthetic_dataset import (
    PARAMETERS,
    PLANS,
    POSE_ROWS,
    POSED_PLANS,
    POSES_PER_PLAN,
    ROWS,
    VIEW_ROWS,
    explored,
    explored_with_left_out,
    rendered,
    shard_of,
    synthetic_run,
    task_of,
)

TABLES = ("pairs", "poses")
_LABEL = [column.name for column in VIEWS.columns if column.name not in ("pair_id", "plan_id")]


@pytest.fixture(scope="module")
def data(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("data")
    explored(folder)
    pack(synthetic_run(folder))
    return folder


@pytest.fixture(scope="module")
def dataset(data) -> Path:
    return data / "dataset"


def _files(dataset: Path) -> dict[str, bytes]:
    names = ("*.parquet", "*.md", "*.png", "manifest.json")
    return {str(p.relative_to(dataset)): p.read_bytes() for n in names for p in sorted(dataset.rglob(n))}


def _plans_by_split(dataset: Path, table: str = "pairs") -> dict[str, set[str]]:
    return {
        split: {
            plan
            for path in dataset.glob(f"{table}/{split}-*.parquet")
            for plan in pq.read_table(path, columns=["plan_id"])["plan_id"].to_pylist()
        }
        for split in SPLITS
    }


def _table(dataset: Path, name: str) -> pa.Table:
    return pa.concat_tables(pq.read_table(path) for path in sorted(dataset.glob(f"{name}/*.parquet")))


def _same(value: Any, other: Any) -> bool:
    return np.array_equal(value, other, equal_nan=True) if isinstance(value, np.ndarray) else value == other


def test_every_sighting_is_published_once_without_the_furniture(dataset):
    table = _table(dataset, "pairs")
    assert table.column_names == [column.name for column in PAIRS.columns]
    ids = table["pair_id"].to_pylist()
    assert sorted(ids) == sorted(row["pair_id"] for rows in ROWS for row in rows)


def test_every_sighting_has_its_own_image_and_label(dataset):
    made = {row["pair_id"]: row for rows in VIEW_ROWS for row in rows}
    assert len({row["image"] for row in made.values()}) == len(made)
    for row in PAIRS.rows(_table(dataset, "pairs")):
        view = made[row["pair_id"]]
        assert [name for name in _LABEL if not _same(row[name], view[name])] == []


def test_every_training_image_is_published_once_as_it_was_made(dataset):
    table = _table(dataset, "poses")
    assert table.column_names == [column.name for column in POSES.columns]
    made = {row["pose_id"]: row for rows in POSE_ROWS for row in rows}
    published = {row["pose_id"]: row for row in POSES.rows(table)}
    assert table.num_rows == len(made)
    assert published.keys() == made.keys()
    for pose_id, row in made.items():
        assert [name for name in row if not _same(published[pose_id][name], row[name])] == []


def test_values_come_through_unchanged(dataset):
    path = next(iter(sorted(dataset.glob("pairs/train-*.parquet"))))
    published = PAIRS.rows(pq.read_table(path))[0]
    plan, event = int(published["plan_id"][-3:]), int(published["event_id"][-1])
    made = ROWS[plan][event]
    assert published["map_1"] == made["map_1"]
    assert published["T_m0_m1_local"] == made["T_m0_m1_local"]
    assert np.array_equal(published["trajectory_0_true"], made["trajectory_0_true"])


@pytest.mark.parametrize(("table", "number"), [("pairs", PLANS), ("poses", POSED_PLANS)])
def test_no_plan_is_in_two_splits_and_none_in_two_files(table, number, dataset):
    plans = _plans_by_split(dataset, table)
    assert all(plans.values())
    assert sum(map(len, plans.values())) == number == len(set.union(*plans.values()))
    of_files = [
        set(pq.read_table(p, columns=["plan_id"])["plan_id"].to_pylist()) for p in dataset.glob(f"{table}/*")
    ]
    assert sum(map(len, of_files)) == number


def test_a_plan_is_in_the_same_split_of_both_tables(dataset):
    pairs, poses = (_plans_by_split(dataset, table) for table in TABLES)
    assert all(pairs[split] <= poses[split] for split in SPLITS)
    assert {f"plan-{plan:03d}" for plan in range(PLANS, POSED_PLANS)} == (
        set.union(*poses.values()) - set.union(*pairs.values())
    )


@pytest.mark.parametrize(("table", "most"), [("pairs", 4), ("poses", POSES_PER_PLAN)])
def test_files_are_numbered_and_hold_the_rows_asked_for(table, most, dataset):
    for split in SPLITS:
        paths = sorted(dataset.glob(f"{table}/{split}-*.parquet"))
        assert [p.name for p in paths] == [
            f"{split}-{i:05d}-of-{len(paths):05d}.parquet" for i in range(len(paths))
        ]
        rows = [pq.read_metadata(p).num_rows for p in paths]
        assert all(r == most for r in rows[:-1])
        assert 0 < rows[-1] <= most


@pytest.mark.parametrize(("table", "images"), [("pairs", {"map_0", "map_1", "image"}), ("poses", {"image"})])
def test_files_have_page_indices_raw_images_and_image_features(table, images, dataset):
    paths = list(dataset.glob(f"{table}/*.parquet"))
    assert len(paths) > 3
    for path in paths:
        metadata = pq.read_metadata(path)
        group = metadata.row_group(0)
        columns = {group.column(i).path_in_schema: group.column(i) for i in range(group.num_columns)}
        # Images are too long to have a least and a greatest.
        bounded = [c for c in columns.values() if c.is_stats_set and c.statistics.has_min_max]
        assert all(c.has_column_index for c in bounded)
        assert columns["plan_id"] in bounded
        assert all(c.has_offset_index for c in columns.values())
        assert {columns[f"{name}.bytes"].compression for name in images} == {"UNCOMPRESSED"}
        assert columns["visibility"].compression == "ZSTD"
        features = json.loads(pq.read_schema(path).metadata[b"huggingface"])["info"]["features"]
        assert features == {name: {"_type": "Image"} for name in images}


def test_packing_again_writes_nothing(data, dataset):
    before = {p: p.stat().st_mtime_ns for p in dataset.rglob("*") if p.is_file() and p.name != ".lock"}
    pack(synthetic_run(data))
    assert {p: p.stat().st_mtime_ns for p in before} == before


def test_bytes_follow_from_what_is_packed_alone(dataset, tmp_path):
    explored(tmp_path)
    pack(synthetic_run(tmp_path))
    assert _files(tmp_path / "dataset") == _files(dataset)


def test_neither_order_nor_number_of_plans_moves_a_plan_to_another_split(dataset, tmp_path):
    explored(tmp_path, turn=3)
    pack(synthetic_run(tmp_path))
    for table in TABLES:
        assert _plans_by_split(tmp_path / "dataset", table) == _plans_by_split(dataset, table)


def test_without_views_sightings_have_no_images(dataset, tmp_path):
    explored(tmp_path)
    rendered(tmp_path, views=False)
    pack(synthetic_run(tmp_path))
    table, seen = _table(tmp_path / "dataset", "pairs"), _table(dataset, "pairs")
    assert table.schema.equals(seen.schema, check_metadata=True)
    assert all(table[name].null_count == table.num_rows for name in _LABEL)
    assert table.drop_columns(_LABEL).equals(seen.drop_columns(_LABEL))


def test_without_poses_there_is_no_such_table(tmp_path):
    explored(tmp_path)
    pack(synthetic_run(tmp_path))
    assert (tmp_path / "dataset" / "poses.png").is_file()
    rendered(tmp_path, poses=[])
    pack(synthetic_run(tmp_path))
    dataset = tmp_path / "dataset"
    assert not list(dataset.glob("poses*/*.parquet"))
    assert not (dataset / "poses.png").exists()
    assert "poses" not in (dataset / "README.md").read_text().split("---")[1]
    assert _table(dataset, "pairs").num_rows == 2 * PLANS


def test_new_images_of_a_plan_make_only_the_file_with_that_plan_again(tmp_path):
    explored(tmp_path)
    pack(synthetic_run(tmp_path))
    before = _files(tmp_path / "dataset")
    rendered(tmp_path, redrawn=["plan-003"])
    run = synthetic_run(tmp_path)
    pack(run)
    after = _files(tmp_path / "dataset")
    changed = [name for name in before if name.endswith(".parquet") and after[name] != before[name]]
    assert after.keys() == before.keys()
    [path] = (tmp_path / "dataset" / name for name in changed)
    rows = PAIRS.rows(pq.read_table(path))
    assert {row["plan_id"] for row in rows if row["drawn"] != "{}"} == {"plan-003"}
    assert "upstream: plan-003 (render) changed" in run.console.file.getvalue()


def test_images_of_other_sightings_are_an_error(tmp_path):
    explored(tmp_path)
    again = [[row | {"t_s": 41.0} for row in ROWS[0]], *ROWS[1:]]
    shard = shard_of([row for rows in again for row in rows])
    task = task_of(part_name(0), shard, parameters=PARAMETERS, items={}, seed=1)
    synthetic_run(tmp_path).build("explore", [task], layout=LAYOUT)
    with pytest.raises(StoreError, match="its images of 'plan-000' were not taken of the sightings in"):
        pack(synthetic_run(tmp_path))


class _KilledError(Exception):
    pass


def test_killed_at_any_file_and_rerun_it_makes_the_same_bytes(dataset, tmp_path, monkeypatch):
    explored(tmp_path)
    write, names = StageWriter.write, []

    def killed(self: StageWriter, name: str, *rest: Any) -> Any:
        if name not in names:
            names.append(name)
            raise _KilledError
        return write(self, name, *rest)

    monkeypatch.setattr(StageWriter, "write", killed)
    for _ in range(len(list(dataset.glob("p*/*.parquet")))):
        with pytest.raises(_KilledError):
            pack(synthetic_run(tmp_path))
    pack(synthetic_run(tmp_path))
    assert _files(tmp_path / "dataset") == _files(dataset)


@pytest.mark.parametrize("table", TABLES)
def test_an_altered_file_is_made_again(table, data, dataset):
    before = _files(dataset)
    victim = next(dataset.glob(f"{table}/test-*.parquet"))
    victim.write_bytes(victim.read_bytes()[:-100])
    pack(synthetic_run(data))
    assert _files(dataset) == before


def test_an_empty_split_is_an_error_that_says_how_many_plans_are_needed(tmp_path):
    explored(tmp_path, plans=2)
    told = "^pairs: .*about 51 plans leave no split empty with 99 % probability"
    with pytest.raises(SplitError, match=told):
        pack(synthetic_run(tmp_path, "pack.validation_fraction=0.1", "pack.test_fraction=0.1"))


def test_a_split_without_poses_is_an_error_where_there_are_poses(tmp_path):
    explored(tmp_path)
    rendered(tmp_path, poses=POSE_ROWS[:1])
    with pytest.raises(SplitError, match=r"^poses: .* would be empty"):
        pack(synthetic_run(tmp_path))


def test_sightings_that_were_never_made_are_an_error(tmp_path):
    with pytest.raises(StoreError, match="run `rendezvous explore` first"):
        pack(synthetic_run(tmp_path))


def test_images_that_were_never_made_are_an_error(tmp_path):
    explored(tmp_path)
    (tmp_path / "render" / "manifest.json").unlink()
    with pytest.raises(StoreError, match="run `rendezvous render` first"):
        pack(synthetic_run(tmp_path))


def test_episodes_in_which_nobody_met_are_an_error(tmp_path):
    task = task_of(part_name(0), shard_of([]), parameters={}, items={})
    synthetic_run(tmp_path).build("explore", [task], layout=LAYOUT)
    with pytest.raises(SplitError, match=r"no robots met in any episode; there is nothing to pack$"):
        pack(synthetic_run(tmp_path))


def test_that_nobody_met_is_told_with_the_episodes_left_out(tmp_path):
    explored_with_left_out(tmp_path, [], ["no room for two starts", "the physics diverged at 0.40 s"])
    told = "nothing to pack; episodes left out: 2, the first: plan-e000: no room for two starts$"
    with pytest.raises(SplitError, match=told):
        pack(synthetic_run(tmp_path))
