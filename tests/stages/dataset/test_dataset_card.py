"""The dataset's card: it tells what is in the tables, and what makes them again."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest
import yaml
from pytest import approx

from rendezvous.config.load import load_config
from rendezvous.engine.run import part_name
from rendezvous.resources import STAGES_YAML
from rendezvous.schema import PAIRS, POSES
from rendezvous.splits import SPLITS
from rendezvous.stages.floorplans import floorplans
from rendezvous.stages.pack import LAYOUT, pack
from rendezvous.store.records import Quarantined
from tests.synthetic_dataset import (
    POSE_ROWS,
    ROWS,
    SHARES,
    VIEW_ROWS,
    explored,
    explored_with_left_out,
    rendered,
    shard_of,
    synthetic_run,
    task_of,
)


@pytest.fixture(scope="module")
def dataset(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("data")
    explored(folder)
    pack(synthetic_run(folder))
    return folder / "dataset"


@pytest.fixture(scope="module")
def card(dataset) -> str:
    return (dataset / "README.md").read_text()


def test_the_card_tells_three_different_reasons_of_the_episodes_left_out(tmp_path):
    reasons = ["no room", "no room", "the physics diverged at 0.40 s", "no start", "no fourth reason"]
    explored_with_left_out(tmp_path, [row for rows in ROWS for row in rows], reasons)
    pack(synthetic_run(tmp_path))
    card = (tmp_path / "dataset" / "README.md").read_text()
    assert "could not be made: 5." in card
    told = re.findall(r"^- `plan-e\d{3}`: (.+)$", card, re.MULTILINE)
    assert told == ["no room", "the physics diverged at 0.40 s", "no start"]


def _rows_by_split(dataset: Path, table: str) -> dict[str, list[dict[str, Any]]]:
    columns = ["plan_id", "visibility"] + (["mode"] if table == "poses" else [])
    return {
        split: [
            row
            for path in dataset.glob(f"{table}/{split}-*.parquet")
            for row in pq.read_table(path, columns=columns).to_pylist()
        ]
        for split in SPLITS
    }


def test_the_card_counts_the_pairs(dataset, card):
    for split, rows in _rows_by_split(dataset, "pairs").items():
        plans = len({row["plan_id"] for row in rows})
        assert f"| {split} | {plans} | {plans} | {len(rows)} | {len(rows)} |" in card
    assert "| episodes without meeting | 5 |" in card
    assert "| `explore.max_range_m` | `4.0` |" in card
    assert "left out" not in card


def test_the_card_counts_the_poses(dataset, card):
    for split, rows in _rows_by_split(dataset, "poses").items():
        plans = len({row["plan_id"] for row in rows})
        plausible = sum(row["mode"] == "plausible" for row in rows)
        assert f"| {split} | {plans} | {plausible} | {len(rows) - plausible} | {len(rows)} |" in card
    assert "| all | 12 | 36 | 24 | 60 |" in card
    assert "absent from 20.0% of the images" in card


def _quantiles(section: str, measure: str) -> list[float]:
    [line] = re.findall(rf"^\| {re.escape(measure)} \|(.+)\|$", section, re.MULTILINE)
    return [float(cell) for cell in line.split("|")]


def test_quantiles_are_those_of_the_images_with_a_robot(card):
    present = [row for rows in POSE_ROWS for row in rows if row["T_c_o"] is not None]
    section = card.split("## Poses")[1]
    shares = (0.05, 0.25, 0.5, 0.75, 0.95)
    distances_m = [np.linalg.norm(row["T_c_o"][:3, 3]) for row in present]
    assert _quantiles(section, "Distance [m]") == approx(np.quantile(distances_m, shares), abs=0.0051)
    visibility = [row["visibility"] for row in present]
    assert _quantiles(section, "Visibility") == approx(np.quantile(visibility, shares), abs=0.0051)


def test_the_card_compares_the_sighting_test_with_what_was_rendered(card):
    visibility = np.array([row["visibility"] for rows in VIEW_ROWS for row in rows])
    fraction = np.array([row["visible_fraction"] for rows in ROWS for row in rows])
    assert 0.0 < np.mean(visibility >= 0.5) < 1.0
    assert "20 of 20 sightings have an image" in card
    assert f"In {np.mean(visibility >= 0.5):.1%} of the images" in card
    assert f"differ by {np.mean(abs(fraction - visibility)):.3f} on average" in card
    section = card.split("## Images of the sightings")[1]
    assert _quantiles(section.split("## ")[0], "Visibility")[2] == approx(np.median(visibility), abs=0.0051)


def test_the_header_names_both_tables_and_pairs_first(card):
    header = yaml.safe_load(card.split("---")[1])
    names = [(config["config_name"], config.get("default", False)) for config in header["configs"]]
    assert names == [("pairs", True), ("poses", False)]
    for config in header["configs"]:
        paths = {file["split"]: file["path"] for file in config["data_files"]}
        assert paths == {split: f"{config['config_name']}/{split}-*.parquet" for split in SPLITS}
    assert 'load_dataset("path/to/this/folder", "poses", split="train")' in card


def test_the_card_describes_every_column_and_shows_every_picture(dataset, card):
    pairs, poses = card.split("## Columns of `pairs`")[1].split("## Columns of `poses`")
    assert all(f"| `{column.name}` |" in pairs for column in PAIRS.columns)
    assert all(f"| `{column.name}` |" in poses for column in POSES.columns)
    shown = re.findall(r"\]\((\w+\.png)\)", card)
    assert sorted(shown) == ["overlap.png", "pairs.png", "poses.png"]
    assert all((dataset / name).is_file() for name in shown)


def test_code_blocks_are_closed(card, tmp_path):
    assert card.count("```") == 2
    explored(tmp_path)
    rendered(tmp_path, poses=[])
    pack(synthetic_run(tmp_path))
    without = (tmp_path / "dataset" / "README.md").read_text()
    assert without.count("```") == 2
    assert "Poses" not in without
    assert "Licences" in without
    assert _carded_parameters(tmp_path)["render.poses_per_plan"] == "0"


def test_the_examples_load_a_split_that_there_is(card, tmp_path):
    assert card.count('split="train")') == 2
    explored(tmp_path)
    pack(synthetic_run(tmp_path, "pack={validation_fraction: 0.0, test_fraction: 1.0}"))
    only_measured = (tmp_path / "dataset" / "README.md").read_text()
    assert only_measured.count('split="test")') == 2
    assert (
        "train" not in yaml.safe_load(only_measured.split("---")[1])["configs"][0]["data_files"][0].values()
    )
    assert not list((tmp_path / "dataset").rglob("train-*"))


def test_without_views_the_card_says_so(card, tmp_path):
    explored(tmp_path)
    rendered(tmp_path, views=False, poses=[])
    pack(synthetic_run(tmp_path))
    without = (tmp_path / "dataset" / "README.md").read_text()
    assert "No sighting has an image: `render.views` was off." in without
    assert "| `render.views` | `false` |" in without
    assert "Licences" not in without
    assert "No sighting has an image" not in card
    assert "| `render.views` | `true` |" in card


@pytest.mark.parametrize(
    ("digest", "told"), [(None, "and no photo is in them."), ("5f3a", "photos from the user's folder")]
)
def test_the_card_tells_whether_there_are_photos_in_the_images(digest, told, tmp_path):
    explored(tmp_path)
    rendered(tmp_path, parameters={"render.backgrounds": digest, "render.jpeg_quality": 95})
    pack(synthetic_run(tmp_path))
    licences = (tmp_path / "dataset" / "README.md").read_text().split("## Licences of the images")[1]
    assert told in licences.split("##")[0]
    assert _carded_parameters(tmp_path)["render.jpeg_quality"] == "95"


def test_the_card_tells_which_training_images_were_left_out(tmp_path):
    explored(tmp_path)
    left_out = Quarantined(item_id="plan-000-p0007", reason="no place for two robots")
    rendered(tmp_path, quarantined=(left_out,), parameters={"render.poses_per_plan": 6})
    pack(synthetic_run(tmp_path))
    poses = (tmp_path / "dataset" / "README.md").read_text().split("## Poses")[1].split("## ")[0]
    assert "Images left out, because they could not be made: 1." in poses
    assert "- `plan-000-p0007`: no place for two robots" in poses


def test_the_card_names_the_robot_that_explored_and_the_stages_it_knows_nothing_of(card):
    assert "Two simulated robots, each a `scout`," in card
    assert "the parameters of `floorplans`, `meshes`.\n" in card
    assert "| `explore.robot.radius_m` | `0.2` |" in card
    assert "`render.robot.radius_m`" not in card


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
    sets = [f"{k}={v}" for k, v in parameters.items() if k.startswith(("floorplans.", "pack."))]
    sets = [text for text in sets if not text.startswith("floorplans.robot.")]  # is in the robot file
    again = load_config(STAGES_YAML, preset="large", overrides=sets)
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
    task = task_of(part_name(0), shard_of([]), parameters={}, items=dict.fromkeys(names, ""), seed=None)
    synthetic_run(tmp_path).build("floorplans", [task], layout=LAYOUT)
    explored(tmp_path)
    pack(synthetic_run(tmp_path))
    parameters = _carded_parameters(tmp_path)
    assert json.loads(parameters["floorplans.sources"]) == sources
    assert parameters["floorplans.generate.count"] == "0"
