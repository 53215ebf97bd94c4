"""Pack, on sightings drawn instead of driven; what it publishes is opened by the programs that users have."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from functools import partial
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from pipeline.config import load_config
from pipeline.engine import Task, part_name
from pipeline.errors import SplitError, StoreError
from pipeline.schema import PAIRS
from pipeline.splits import SPLITS
from pipeline.stages.floorplans import floorplans
from pipeline.stages.pack import LAYOUT, pack
from pipeline.store.records import Inputs, Quarantined, Shard
from tests.synthetic_dataset import (
    PARAMETERS,
    PLANS,
    ROWS,
    SHARES,
    STAGES_YAML,
    explored,
    shard_of,
    synthetic_run,
)


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


def _plans_by_split(dataset: Path) -> dict[str, set[str]]:
    return {
        split: {
            plan
            for path in dataset.glob(f"pairs/{split}-*.parquet")
            for plan in pq.read_table(path, columns=["plan_id"])["plan_id"].to_pylist()
        }
        for split in SPLITS
    }


def test_every_sighting_is_published_once_without_the_furniture(dataset):
    table = pa.concat_tables(pq.read_table(path) for path in sorted(dataset.glob("pairs/*.parquet")))
    assert table.column_names == [column.name for column in PAIRS.columns]
    ids = table["pair_id"].to_pylist()
    assert sorted(ids) == sorted(row["pair_id"] for rows in ROWS for row in rows)


def test_values_come_through_unchanged(dataset):
    path = next(iter(sorted(dataset.glob("pairs/train-*.parquet"))))
    published = PAIRS.rows(pq.read_table(path))[0]
    plan, event = int(published["plan_id"][-3:]), int(published["event_id"][-1])
    made = ROWS[plan][event]
    assert published["map_1"] == made["map_1"]
    assert published["T_m0_m1_local"] == made["T_m0_m1_local"]
    assert np.array_equal(published["trajectory_0_true"], made["trajectory_0_true"])


def test_no_plan_is_in_two_splits_and_none_in_two_files(dataset):
    plans = _plans_by_split(dataset)
    assert all(plans.values())
    assert sum(map(len, plans.values())) == PLANS == len(set.union(*plans.values()))
    of_files = [
        set(pq.read_table(p, columns=["plan_id"])["plan_id"].to_pylist()) for p in dataset.glob("pairs/*")
    ]
    assert sum(map(len, of_files)) == PLANS


def test_files_are_numbered_and_hold_the_rows_asked_for(dataset):
    for split in SPLITS:
        paths = sorted(dataset.glob(f"pairs/{split}-*.parquet"))
        assert [p.name for p in paths] == [
            f"{split}-{i:05d}-of-{len(paths):05d}.parquet" for i in range(len(paths))
        ]
        rows = [pq.read_metadata(p).num_rows for p in paths]
        assert all(r == 4 for r in rows[:-1])
        assert 0 < rows[-1] <= 4


def test_files_have_page_indices_raw_images_and_image_features(dataset):
    for path in dataset.glob("pairs/*.parquet"):
        metadata = pq.read_metadata(path)
        group = metadata.row_group(0)
        columns = {group.column(i).path_in_schema: group.column(i) for i in range(group.num_columns)}
        assert all(c.has_column_index or c.is_stats_set is False for c in columns.values())
        assert all(c.has_offset_index for c in columns.values())
        assert {columns[f"{name}.bytes"].compression for name in ("map_0", "map_1", "image")} == {
            "UNCOMPRESSED"
        }
        assert columns["overlap"].compression == "ZSTD"
        features = json.loads(pq.read_schema(path).metadata[b"huggingface"])["info"]["features"]
        assert features["map_0"] == {"_type": "Image"}


def test_packing_again_writes_nothing(data, dataset):
    before = {p: p.stat().st_mtime_ns for p in dataset.rglob("*") if p.is_file() and p.name != ".lock"}
    pack(synthetic_run(data))
    assert {p: p.stat().st_mtime_ns for p in before} == before


def test_bytes_follow_from_the_sightings_alone(dataset, tmp_path):
    explored(tmp_path)
    pack(synthetic_run(tmp_path))
    assert _files(tmp_path / "dataset") == _files(dataset)


def test_neither_order_nor_number_of_plans_moves_a_plan_to_another_split(dataset, tmp_path):
    explored(tmp_path, turn=3)
    pack(synthetic_run(tmp_path))
    turned = _plans_by_split(tmp_path / "dataset")
    assert turned == _plans_by_split(dataset)


def test_an_altered_file_is_made_again(data, dataset):
    before = _files(dataset)
    victim = next(dataset.glob("pairs/test-*.parquet"))
    victim.write_bytes(victim.read_bytes()[:-100])
    pack(synthetic_run(data))
    assert _files(dataset) == before


def test_an_empty_split_is_an_error_that_says_how_many_plans_are_needed(tmp_path):
    explored(tmp_path, plans=2)
    with pytest.raises(SplitError, match="about 51 plans leave no split empty with 99 % probability"):
        pack(synthetic_run(tmp_path, "pack.validation_fraction=0.1", "pack.test_fraction=0.1"))


def test_sightings_that_were_never_made_are_an_error(tmp_path):
    with pytest.raises(StoreError, match="run `rendezvous explore` first"):
        pack(synthetic_run(tmp_path))


def test_episodes_in_which_nobody_met_are_an_error(tmp_path):
    task = Task(name=part_name(0), inputs=Inputs(parameters={}, items={}), make=partial(shard_of, []))
    synthetic_run(tmp_path).build("explore", [task], layout=LAYOUT)
    with pytest.raises(SplitError, match=r"no robots met in any episode; there is nothing to pack$"):
        pack(synthetic_run(tmp_path))


def _explored_with_left_out(data: Path, rows: list, reasons: list[str]) -> None:
    """Stands in for an `explore` that could not run as many episodes as there are reasons."""
    left_out = tuple(Quarantined(item_id=f"plan-e{i:03d}", reason=reason) for i, reason in enumerate(reasons))
    made = shard_of(rows)
    shard = Shard(table=made.table, counts=made.counts, quarantined=left_out)
    task = Task(
        name=part_name(0), inputs=Inputs(parameters=PARAMETERS, items={}), make=partial(_given, shard)
    )
    synthetic_run(data).build("explore", [task], layout=LAYOUT)


def _given(shard: Shard) -> Shard:
    return shard


def test_that_nobody_met_is_told_with_the_episodes_left_out(tmp_path):
    _explored_with_left_out(tmp_path, [], ["no room for two starts", "the physics diverged at 0.40 s"])
    told = "nothing to pack; episodes left out: 2, the first: plan-e000: no room for two starts$"
    with pytest.raises(SplitError, match=told):
        pack(synthetic_run(tmp_path))


def test_the_card_tells_three_different_reasons_of_the_episodes_left_out(tmp_path):
    reasons = ["no room", "no room", "the physics diverged at 0.40 s", "no start", "no fourth reason"]
    _explored_with_left_out(tmp_path, [row for rows in ROWS for row in rows], reasons)
    pack(synthetic_run(tmp_path))
    card = (tmp_path / "dataset" / "README.md").read_text()
    assert "could not be run: 5." in card
    told = re.findall(r"^- `plan-e\d{3}`: (.+)$", card, re.MULTILINE)
    assert told == ["no room", "the physics diverged at 0.40 s", "no start"]


def test_the_card_counts_what_is_there(dataset):
    card = (dataset / "README.md").read_text()
    plans = _plans_by_split(dataset)
    for split in SPLITS:
        assert f"| {split} | {len(plans[split])} | {len(plans[split])} | {2 * len(plans[split])} |" in card
    assert "| episodes without meeting | 5 |" in card
    assert "| `explore.max_range_m` | `4.0` |" in card
    assert all(f"| `{column.name}` |" in card for column in PAIRS.columns)
    assert (dataset / "pairs.png").is_file()
    assert "](pairs.png)" in card
    assert "](overlap.png)" in card
    assert "left out" not in card


def test_the_card_names_the_robot_that_explored_and_the_stages_it_knows_nothing_of(dataset):
    card = (dataset / "README.md").read_text()
    assert "Two simulated robots, each a `scout`," in card
    assert "the parameters of `floorplans`, `meshes`.\n" in card


def _carded_parameters(data: Path) -> dict[str, str]:
    card = (data / "dataset" / "README.md").read_text()
    return dict(re.findall(r"^\| `([\w.]+)` \| `(.+)` \|$", card, re.MULTILINE))


def test_the_parameters_of_the_card_make_floor_plans_and_files_again(tmp_path):
    made = synthetic_run(tmp_path, "floorplans.limits.min_area_m2=16.5", "floorplans.generate.count=3")
    floorplans(made)
    explored(tmp_path)
    # Packed by a run that is set otherwise: the card tells what was made, not what would be made now.
    pack(synthetic_run(tmp_path, "floorplans.generate.count=7", "floorplans.sources=[elsewhere]"))
    parameters = _carded_parameters(tmp_path)
    told = [f"{k}={v}" for k, v in parameters.items() if k.startswith(("floorplans.", "pack."))]
    again = load_config(STAGES_YAML, preset="large", overrides=told)
    shards = {"plans_per_shard": made.config.floorplans.plans_per_shard}
    assert again.floorplans.model_copy(update=shards) == made.config.floorplans
    assert again.pack == made.config.pack
    assert load_config(STAGES_YAML, preset="large", overrides=SHARES).floorplans != made.config.floorplans


_ARCHIVED = [f"x/json.tar.gz:json/{i}.json" for i in range(101)]


@pytest.mark.parametrize(
    ("names", "sources"),
    [
        (["a/1.json", "b/2.json", *_ARCHIVED], ["a/1.json", "b/2.json", "x/json.tar.gz"]),
        ([*(f"a/{i}.json" for i in range(101)), "b/c/2.json", *_ARCHIVED], ["a", "b/c", "x/json.tar.gz"]),
    ],
)
def test_the_card_tells_few_files_by_name_many_by_folder_and_archives_whole(names, sources, tmp_path):
    inputs = Inputs(parameters={}, items=dict.fromkeys(names, ""))
    task = Task(name=part_name(0), inputs=inputs, make=partial(shard_of, []))
    synthetic_run(tmp_path).build("floorplans", [task], layout=LAYOUT)
    explored(tmp_path)
    pack(synthetic_run(tmp_path))
    parameters = _carded_parameters(tmp_path)
    assert json.loads(parameters["floorplans.sources"]) == sources
    assert parameters["floorplans.generate.count"] == "0"


# The three programs run in a process of their own, as a user's would, with no trace of this package.

_DATASETS = """
import datasets, sys
pairs = datasets.load_dataset(sys.argv[1])
assert set(pairs) == {"train", "validation", "test"}, pairs
assert sum(len(split) for split in pairs.values()) == 20
row = pairs["train"][0]
assert isinstance(pairs["train"].features["map_0"], datasets.Image)
assert row["map_0"].mode == "L" and {value for _, value in row["map_0"].getcolors()} <= {0, 205, 254}
assert len(row["T_m0_m1_local"]) == 3 and row["image"] is None
for streamed in datasets.load_dataset(sys.argv[1], split="test", streaming=True):
    assert streamed["map_1"].size[0] > 10 and len(streamed["trajectory_0"]) > 10
"""

_DUCKDB = """
import duckdb, sys
counts = "count(*), count(distinct plan_id), max(len(T_m0_r0))"
assert duckdb.sql(f"select {counts} from '{sys.argv[1]}/pairs/*.parquet'").fetchall() == [(20, 10, 3)]
assert duckdb.sql(f"select * from '{sys.argv[1]}/pairs/*.parquet' where overlap > 1").fetchall() == []
png = duckdb.sql(f"select map_0.bytes from '{sys.argv[1]}/pairs/train-*.parquet'").fetchall()[0][0]
assert png.startswith(b"\\x89PNG")
"""

_POLARS = """
import polars, sys
pairs = polars.read_parquet(f"{sys.argv[1]}/pairs/*.parquet")
assert pairs.height == 20 and pairs["plan_id"].n_unique() == 10
assert pairs["map_0"].struct.field("bytes")[0].startswith(b"\\x89PNG")
assert pairs["T_m0_m1_local"].dtype == polars.Array(polars.Float64, 3)
lazy = polars.scan_parquet(f"{sys.argv[1]}/pairs/train-*.parquet").filter(polars.col("overlap") > 2).collect()
assert lazy.height == 0
"""


@pytest.mark.parametrize("program", [_DATASETS, _DUCKDB, _POLARS], ids=["datasets", "duckdb", "polars"])
def test_opens_with_no_options_in(program, dataset, tmp_path):
    environment = {"HF_HOME": str(tmp_path), "HF_DATASETS_OFFLINE": "1", "HF_HUB_OFFLINE": "1"}
    done = subprocess.run(
        [sys.executable, "-c", program, str(dataset)],
        env={"PATH": "", "HOME": str(tmp_path), **environment},
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr[-2000:]
