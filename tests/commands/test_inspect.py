from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from rendezvous.commands.inspect import Order, Selection, ShownTable, inspect
from rendezvous.errors import ConfigError, StoreError
from rendezvous.evaluation.pictures.canvas import SHEET_WIDTH_PX
from rendezvous.evaluation.pictures.poses import CUBOID_COLOUR
from rendezvous.floorplan.generate import shipped_floorplans
from rendezvous.plan_schema import MESHES, PLAN_COLUMNS, plan_row
from rendezvous.schema import EXPLORE, PAIRS, POSES, VIEWS, TableSchema
from rendezvous.store.records import Inputs, Shard
from rendezvous.store.tables import Layout
from rendezvous.store.write import StageWriter
from tests.floorplan.plans import RADIUS_M
from tests.synthetic import synthetic_pose, synthetic_row, synthetic_view


def _written(folder: Path, stage: str, *tables, **foldered) -> str:
    """A finished stage of one shard per table, those with a name in a folder of that name."""
    named = [(f"part-{i:05d}.parquet", table) for i, table in enumerate(tables)]
    named += [(f"{name}/part-00000.parquet", table) for name, table in foldered.items()]
    writer = StageWriter(str(folder), stage, Layout(item_column="plan_id"))
    records = [
        writer.write(
            name, Inputs(parameters={}, items={name: ""}), Shard(table=table, counts={"rows": table.num_rows})
        )
        for name, table in named
    ]
    writer.finish(records, {})
    return str(folder)


def _pairs(count: int, *, images: bool = True):
    rows = [synthetic_row(np.random.default_rng(plan), plan=plan) for plan in range(count)]
    for row in rows:
        view = synthetic_view(row) if images else {}
        row |= view
        del row["furniture"]
    return PAIRS.table(rows)


def _poses(count: int):
    return POSES.table([synthetic_pose(plan=0, number=i) for i in range(count)])


@pytest.fixture(scope="module")
def sightings(tmp_path_factory) -> str:
    rows = [synthetic_row(np.random.default_rng(plan), plan=plan) for plan in range(4)]
    folder = tmp_path_factory.mktemp("explore")
    return _written(folder, "explore", EXPLORE.table(rows[:1]), EXPLORE.table(rows[1:]))


def test_pairs_of_all_shards_come_on_one_sheet(sightings, tmp_path):
    found = inspect(sightings, output=tmp_path / "new" / "pairs.png", selection=Selection(count=9))
    assert found.pictures == (tmp_path / "new" / "pairs.png",)
    sheet = cv2.imread(str(found.pictures[0]))
    one = inspect(
        sightings, output=tmp_path / "one.png", selection=Selection(count=1, order=Order.RANDOM)
    ).pictures
    assert sheet.shape[1] == SHEET_WIDTH_PX
    assert sheet.shape[0] > 3 * (cv2.imread(str(one[0])).shape[0] - 200)
    assert "| rows | 4 |" in found.summary
    assert "SLAM position error [cm]" in found.summary


def test_a_random_choice_is_that_of_its_seed(sightings, tmp_path):
    pictures = [
        inspect(
            sightings,
            output=tmp_path / f"{i}.png",
            selection=Selection(count=2, order=Order.RANDOM, seed=seed),
        )
        .pictures[0]
        .read_bytes()
        for i, seed in enumerate((0, 0, 1))
    ]
    assert pictures[0] == pictures[1] != pictures[2]


def test_plans_come_with_their_furniture(tmp_path):
    columns = {"furniture", *PLAN_COLUMNS}
    drawn = TableSchema(name="meshes", columns=tuple(c for c in MESHES.columns if c.name in columns))
    plans = shipped_floorplans(2, seed=0, robot_radius_m=RADIUS_M)
    table = {
        "shape": "box", "x_m": 1.0, "y_m": 1.0, "yaw_rad": 0.0, "half_x_m": 0.5, "half_y_m": 0.5,
        "z0_m": 0.0, "z1_m": 0.7, "category": "table", "item": 0,
    }  # fmt: skip
    pictures = []
    for name, furniture in (("bare", []), ("furnished", [table])):
        rows = [plan_row(plan) | {"furniture": furniture} for plan in plans]
        folder = _written(tmp_path / name, "meshes", drawn.table(rows))
        pictures.append(cv2.imread(str(inspect(folder, output=tmp_path / f"{name}.png").pictures[0])))
    assert pictures[0].shape == pictures[1].shape
    assert (pictures[0] != pictures[1]).any()


@pytest.mark.parametrize("output", ["/proc/x/y.png", "."])
def test_a_picture_that_cannot_be_written_is_told(sightings, output: str):
    with pytest.raises(StoreError, match=r"cannot be written \(.*\); --out names a PNG file"):
        inspect(sightings, output=Path(output), selection=Selection(count=1))


def test_an_unfinished_or_empty_stage_is_an_error(tmp_path):
    with pytest.raises(StoreError, match=r"no manifest\.json"):
        inspect(str(tmp_path / "nowhere"))
    empty = _written(tmp_path / "empty", "explore", EXPLORE.table([]))
    with pytest.raises(StoreError, match="empty: no rows to look at"):
        inspect(empty)


@pytest.fixture(scope="module")
def dataset(tmp_path_factory) -> str:
    return _written(tmp_path_factory.mktemp("dataset"), "pack", pairs=_pairs(2), poses=_poses(10))


def test_a_dataset_is_drawn_on_a_sheet_for_each_table(dataset, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    found = inspect(dataset)
    assert found.pictures == (Path("report/pairs.png"), Path("report/poses.png"))
    assert all(cv2.imread(str(picture)).shape[1] == SHEET_WIDTH_PX for picture in found.pictures)
    assert "| `free` | 5 |\n| `plausible` | 5 |\n| without robot | 20.0% |" in found.summary
    assert all(f"\n| {name} |" in found.summary for name in ("Overlap", "Visibility", "Distance [m]"))


def test_quantiles_are_those_of_the_images_with_a_robot(dataset, tmp_path):
    summary = inspect(dataset, output=tmp_path / "x.png", table=ShownTable.POSES).summary
    shown = [pose for i in range(10) if (pose := synthetic_pose(plan=0, number=i))["T_c_o"] is not None]
    median_m = np.median([np.linalg.norm(pose["T_c_o"][:3, 3]) for pose in shown])
    line = next(line for line in summary.splitlines() if line.startswith("| Distance"))
    assert line.split(" | ")[3] == f"{median_m:.2f}"
    assert "Overlap" not in summary


def test_pairs_are_drawn_with_their_images(dataset, tmp_path):
    without = _written(tmp_path / "without", "pack", pairs=_pairs(2, images=False))
    drawn = [
        cv2.imread(str(inspect(folder, output=tmp_path / f"{i}.png", table=ShownTable.PAIRS).pictures[0]))
        for i, folder in enumerate((dataset, without))
    ]
    assert [(sheet == CUBOID_COLOUR[::-1]).all(axis=2).any() for sheet in drawn] == [True, False]


def test_a_dataset_without_poses_is_drawn(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    folder = _written(tmp_path / "d", "pack", pairs=_pairs(1, images=False), poses=POSES.table([]))
    found = inspect(folder)
    assert found.pictures == (Path("report/pairs.png"),)
    assert "isibility" not in found.summary
    with pytest.raises(ConfigError, match=r"--table is 'poses'; .*/d has pairs$"):
        inspect(folder, table=ShownTable.POSES)


def test_what_render_made_is_drawn(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    views = VIEWS.table([synthetic_view(synthetic_row(np.random.default_rng(1), plan=1))])
    both = _written(tmp_path / "both", "render", views=views, poses=_poses(5))
    assert inspect(both).pictures == (Path("report/views.png"), Path("report/poses.png"))
    assert inspect(_written(tmp_path / "one", "render", views=views)).pictures == (Path("report/views.png"),)


def test_images_go_from_hidden_to_visible_unless_drawn_at_random(dataset, tmp_path):
    """The first of two images, by visibility, is one of the lower half: here one without robot."""
    heads = {}
    for name, order in (("default", None), ("visibility", Order.VISIBILITY), ("random", Order.RANDOM)):
        selection = Selection(count=10, order=order)
        (picture,) = inspect(
            dataset, output=tmp_path / f"{name}.png", table=ShownTable.POSES, selection=selection
        ).pictures
        heads[name] = picture.read_bytes()
    assert heads["default"] == heads["visibility"] != heads["random"]
    sheet = cv2.imread(str(tmp_path / "default.png"))
    labelled = np.linalg.norm(sheet[112:400].astype(float) - CUBOID_COLOUR[::-1], axis=2) < 60.0
    assert not labelled[:, : SHEET_WIDTH_PX // 2].any()
    assert labelled[:, SHEET_WIDTH_PX // 2 :].any()


def test_an_order_that_a_table_cannot_have_is_told(dataset, sightings, tmp_path):
    for folder, table, order in (
        (dataset, ShownTable.POSES, Order.OVERLAP),
        (sightings, ShownTable.PAIRS, Order.VISIBILITY),
    ):
        with pytest.raises(ConfigError, match=f"--order is '{order}', which no {table} here have"):
            inspect(folder, output=tmp_path / "x.png", table=table, selection=Selection(order=order))


def test_one_file_cannot_take_two_sheets(dataset, tmp_path):
    with pytest.raises(ConfigError, match="--out names one picture; choose --table pairs or poses"):
        inspect(dataset, output=tmp_path / "x.png")


def test_plans_have_no_other_table(tmp_path):
    columns = tuple(c for c in MESHES.columns if c.name in PLAN_COLUMNS)
    rows = [plan_row(plan) for plan in shipped_floorplans(1, seed=0, robot_radius_m=RADIUS_M)]
    folder = _written(
        tmp_path / "plans", "floorplans", TableSchema(name="floorplans", columns=columns).table(rows)
    )
    with pytest.raises(ConfigError, match=r"--table is 'poses'; .*/plans has only plans"):
        inspect(folder, table=ShownTable.POSES)
