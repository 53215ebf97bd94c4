from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from pipeline.errors import StoreError
from pipeline.evaluation.canvas import SHEET_WIDTH_PX
from pipeline.floorplan.generate import shipped_floorplans
from pipeline.plan_schema import MESHES, PLAN_COLUMNS, plan_row
from pipeline.schema import EXPLORE, TableSchema
from pipeline.stages.inspect import Order, inspect
from pipeline.store.parquet import Layout
from pipeline.store.records import Inputs, Shard
from pipeline.store.write import StageWriter
from tests.synthetic import synthetic_row


def _written(folder: Path, stage: str, *tables) -> str:
    """A finished stage of one shard per table."""
    writer = StageWriter(str(folder), stage, Layout(item_column="plan_id"))
    records = [
        writer.write(
            f"part-{i:05d}.parquet",
            Inputs(parameters={}, items={str(i): ""}),
            Shard(table=table, counts={"rows": table.num_rows}),
        )
        for i, table in enumerate(tables)
    ]
    writer.finish(records, {})
    return str(folder)


@pytest.fixture(scope="module")
def sightings(tmp_path_factory) -> str:
    rows = [synthetic_row(np.random.default_rng(plan), plan=plan) for plan in range(4)]
    folder = tmp_path_factory.mktemp("explore")
    return _written(folder, "explore", EXPLORE.table(rows[:1]), EXPLORE.table(rows[1:]))


def test_pairs_of_all_shards_come_on_one_sheet(sightings, tmp_path):
    found = inspect(sightings, output=tmp_path / "new" / "pairs.png", count=9)
    sheet = cv2.imread(str(tmp_path / "new" / "pairs.png"))
    one = inspect(sightings, output=tmp_path / "one.png", count=1, order=Order.RANDOM)
    assert sheet.shape[1] == SHEET_WIDTH_PX
    assert sheet.shape[0] > 3 * (cv2.imread(str(one.picture)).shape[0] - 200)
    assert "| rows | 4 |" in found.summary
    assert "SLAM position error [cm]" in found.summary


def test_a_random_choice_is_that_of_its_seed(sightings, tmp_path):
    pictures = [
        inspect(
            sightings, output=tmp_path / f"{i}.png", count=2, order=Order.RANDOM, seed=seed
        ).picture.read_bytes()
        for i, seed in enumerate((0, 0, 1))
    ]
    assert pictures[0] == pictures[1] != pictures[2]


def test_plans_come_with_their_furniture(tmp_path):
    columns = {"furniture", *PLAN_COLUMNS}
    drawn = TableSchema(name="meshes", columns=tuple(c for c in MESHES.columns if c.name in columns))
    plans = shipped_floorplans(2, seed=0)
    table = {
        "shape": "box", "x_m": 1.0, "y_m": 1.0, "yaw_rad": 0.0, "half_x_m": 0.5, "half_y_m": 0.5,
        "z0_m": 0.0, "z1_m": 0.7, "category": "table", "item": 0,
    }  # fmt: skip
    pictures = []
    for name, furniture in (("bare", []), ("furnished", [table])):
        rows = [plan_row(plan) | {"furniture": furniture} for plan in plans]
        folder = _written(tmp_path / name, "meshes", drawn.table(rows))
        pictures.append(cv2.imread(str(inspect(folder, output=tmp_path / f"{name}.png").picture)))
    assert pictures[0].shape == pictures[1].shape
    assert (pictures[0] != pictures[1]).any()


@pytest.mark.parametrize("output", ["/proc/x/y.png", "."])
def test_a_picture_that_cannot_be_written_is_told(sightings, output: str):
    with pytest.raises(StoreError, match=r"cannot be written \(.*\); --out names a PNG file"):
        inspect(sightings, output=Path(output), count=1)


def test_an_unfinished_or_empty_stage_is_an_error(tmp_path):
    with pytest.raises(StoreError, match=r"no manifest\.json"):
        inspect(str(tmp_path / "nowhere"))
    empty = _written(tmp_path / "empty", "explore", EXPLORE.table([]))
    with pytest.raises(StoreError, match="empty: no rows to look at"):
        inspect(empty)
