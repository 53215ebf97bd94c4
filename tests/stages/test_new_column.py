"""A column added to a table, with nothing else changed: what is made again, and what is kept."""

from __future__ import annotations

import re
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from typing import Any

import pyarrow as pa
import pytest

from rendezvous import schema
from rendezvous.config.stage_table import DATASET_STAGES
from rendezvous.errors import StoreError
from rendezvous.stages import stage_function
from rendezvous.store.records import Shard
from tests.conftest import run_in
from tests.synthetic_dataset import POSE_ROWS, ROWS, VIEW_ROWS

ONE_PLAN = (
    "floorplans.sources=[floorplans/rdv-012.json]",
    "floorplans.generate.count=0",
    "pack={validation_fraction: 0.0, test_fraction: 0.0}",
)
WEATHER = schema.Column(name="weather", type=pa.string(), about="Indoors.")


def _on_the_plan(rows: Any) -> list[dict[str, Any]]:
    """The synthetic rows of one plan as rows of the real one."""
    return [row | {"plan_id": "rdv-012"} for row in rows[0]]


def _with(table: schema.TableSchema) -> schema.TableSchema:
    return replace(table, columns=(*table.columns, WEATHER))


@pytest.fixture
def drawn(monkeypatch: pytest.MonkeyPatch) -> pytest.MonkeyPatch:
    """`explore` and `render` draw their rows instead of driving and rendering."""
    explore, render = (import_module(f"rendezvous.stages.{name}") for name in ("explore", "render"))

    def explored(*_: Any) -> Shard:
        weather = {"weather": "dry"} if WEATHER in explore.EXPLORE.columns else {}
        table = explore.EXPLORE.table([row | weather for row in _on_the_plan(ROWS)])
        return Shard(table=table, counts={"episodes": 1})

    monkeypatch.setattr(explore, "explored_plans", explored)
    monkeypatch.setattr(render, "views", lambda *_: Shard(table=schema.VIEWS.table(_on_the_plan(VIEW_ROWS))))
    monkeypatch.setattr(render, "poses", lambda *_: Shard(table=schema.POSES.table(_on_the_plan(POSE_ROWS))))
    monkeypatch.setattr(render, "renderer_name", lambda: "none")
    return monkeypatch


def _made(data: str) -> dict[str, tuple[int, int]]:
    """Runs the stages of a dataset: how many shards each made and kept."""
    run = run_in(data, ONE_PLAN)
    for stage in DATASET_STAGES:
        stage_function(stage)(run)
    said = re.findall(r"^(\w+): .* shards; (\d+) made, (\d+) kept", run.console.file.getvalue(), re.MULTILINE)
    return {stage: (int(made), int(kept)) for stage, made, kept in said}


def _publish(drawn: pytest.MonkeyPatch) -> None:
    pack, published = (import_module(f"rendezvous.stages.{name}") for name in ("pack", "dataset.published"))
    for module in (pack, published):
        drawn.setattr(module, "PAIRS", _with(schema.PAIRS))
    drawn.setattr(published, "EXPLORE", _with(schema.EXPLORE))
    drawn.setattr(published, "_SIGHTING_COLUMNS", (*published._SIGHTING_COLUMNS, WEATHER.name))


def test_a_new_column_makes_again_what_holds_it_and_what_is_made_of_that(drawn, tmp_path: Path):
    data = str(tmp_path)
    assert {kept for _, kept in _made(data).values()} == {0}
    drawn.setattr(import_module("rendezvous.stages.explore"), "EXPLORE", _with(schema.EXPLORE))
    _publish(drawn)
    assert _made(data) == {
        "floorplans": (0, 1),
        "meshes": (0, 1),
        "explore": (1, 0),
        "render": (1, 1),  # views are of other sightings now; training images are of none
        "pack": (1, 1),
    }
    table = run_in(data, ONE_PLAN).read("pack").table("pairs/train-00000-of-00001.parquet")
    assert set(table["weather"].to_pylist()) == {"dry"}


def test_a_column_of_training_images_alone_leaves_views_and_pairs(drawn, tmp_path: Path):
    data = str(tmp_path)
    _made(data)
    render, pack = (import_module(f"rendezvous.stages.{name}") for name in ("render", "pack"))
    published = import_module("rendezvous.stages.dataset.published")
    rows = [row | {"weather": "dry"} for row in _on_the_plan(POSE_ROWS)]
    for module in (render, pack, published):
        drawn.setattr(module, "POSES", _with(schema.POSES))
    drawn.setattr(render, "poses", lambda *_: Shard(table=_with(schema.POSES).table(rows)))
    made = _made(data)
    assert made["explore"] == (0, 1)
    assert made["render"] == made["pack"] == (1, 1)


def test_a_column_that_an_old_shard_lacks_is_one_line(drawn, tmp_path: Path):
    _made(str(tmp_path))
    _publish(drawn)
    file = f"{tmp_path}/explore/part-00000.parquet"
    said = rf"^{file}: table explore has no column 'weather'; `rendezvous explore` makes it again$"
    with pytest.raises(StoreError, match=said):
        stage_function("pack")(run_in(str(tmp_path), ONE_PLAN))


def test_a_shard_of_other_columns_than_its_inputs_name_is_not_written(drawn, tmp_path: Path):
    explore = import_module("rendezvous.stages.explore")
    table = _with(schema.EXPLORE).table([row | {"weather": "dry"} for row in _on_the_plan(ROWS)])
    drawn.setattr(explore, "explored_plans", lambda *_: Shard(table=table, counts={"episodes": 1}))
    with pytest.raises(AssertionError, match="columns of its inputs"):
        _made(str(tmp_path))
