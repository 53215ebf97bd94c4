"""The whole pipeline on four floor plans: the same bytes however it was run, and nothing done twice."""

from __future__ import annotations

import os
import random
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from rendezvous.config.stage_table import DATASET_STAGES
from rendezvous.store.read import StageReader
from tests.conftest import ROOT, wait_until
from tests.toy_stage import folder_content

pytestmark = pytest.mark.slow

FOUR_PLANS = (
    "floorplans.sources=[floorplans/rdv-000.json, floorplans/rdv-001.json, floorplans/rdv-002.json]",
    "floorplans.generate.count=1",
    "floorplans.plans_per_shard=1",
    "explore.episodes_per_plan=1",
    "render.poses_per_plan=2",
    "pack={validation_fraction: 0.25, test_fraction: 0.25}",
)

INLINE = ("--engine", "inline")
"""Where it does not count who makes the shards: a worker's start takes longer than most of them."""


def command(data: Path, *options: str, stage: str = "dataset") -> list[str]:
    sets = [word for item in FOUR_PLANS for word in ("--set", item)]
    start = [sys.executable, "-m", "rendezvous.cli", stage, "--preset", "smoke", *sets]
    return [*start, "--data", str(data), *options]


def run(data: Path, *options: str, stage: str = "dataset") -> str:
    done = subprocess.run(
        command(data, *options, stage=stage), cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    return done.stderr


def assert_same(folder: Path, other: Path) -> None:
    """Names first: a difference of megabytes tells nobody anything."""
    found, expected = folder_content(folder), folder_content(other)
    assert sorted(found) == sorted(expected)
    assert [name for name in found if found[name] != expected[name]] == []


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """In one process, nothing in its way."""
    data = tmp_path_factory.mktemp("pipeline") / "data"
    run(data, *INLINE)
    return data


def test_two_workers_make_the_same_bytes(made: Path, tmp_path: Path) -> None:
    run(tmp_path, "--workers", "2")
    assert_same(tmp_path, made)


def test_killed_at_random_moments_and_rerun_it_makes_the_same_bytes(made: Path, tmp_path: Path) -> None:
    rng = random.Random(3)
    shard_count = len(list(made.rglob("*.parquet")))
    for shards in (1, shard_count // 3, 2 * shard_count // 3):
        process = subprocess.Popen(
            command(tmp_path, "--workers", "2"), cwd=ROOT, stderr=subprocess.DEVNULL, start_new_session=True
        )
        wait_until(lambda: len(list(tmp_path.rglob("*.parquet"))) >= shards, process)  # noqa: B023
        time.sleep(rng.uniform(0.0, 0.5))
        os.killpg(process.pid, signal.SIGKILL)
        process.wait()
    run(tmp_path, "--workers", "2")
    assert_same(tmp_path, made)


def test_a_rerun_makes_nothing_and_a_harmed_shard_is_made_again(made: Path) -> None:
    before = folder_content(made)
    said = run(made)
    assert said.count(" 0 made,") == len(DATASET_STAGES)
    shard = made / "explore" / "part-00001.parquet"
    shard.write_bytes(shard.read_bytes()[:-100])
    verify = [sys.executable, "-m", "rendezvous.cli", "verify", str(made)]
    found = subprocess.run(verify, cwd=ROOT, capture_output=True, text=True, check=False)
    assert found.returncode == 1
    assert found.stdout.count("\n") == 1
    assert "part-00001.parquet" in found.stdout
    assert "explore: making part-00001.parquet again" in run(made)
    assert folder_content(made) == before


def test_a_parameter_of_explore_leaves_what_is_above_it_alone(made: Path, tmp_path: Path) -> None:
    data = shutil.copytree(made, tmp_path / "data")
    said = run(data, *INLINE, "--set", "explore.episode.max_events=2")
    floorplans, meshes, explore, render, pack = (line for line in said.splitlines() if " made, " in line)
    assert " 0 made," in floorplans
    assert " 0 made," in meshes
    assert " 0 kept," in explore
    assert render.startswith("render: ")
    assert pack.startswith("pack: ")
    assert "explore.episode.max_events changed 3 -> 2" in said


def test_seeds_0_and_1_differ_in_everything_that_is_drawn(made: Path, tmp_path: Path) -> None:
    for stage in ("floorplans", "meshes", "explore"):
        run(tmp_path, *INLINE, "--seed", "1", stage=stage)
    rows = [
        list(StageReader(str(data / "explore")).rows(columns=["seed", "T_w_m0"])) for data in (made, tmp_path)
    ]
    assert all(row["seed"] == seed for seed in (0, 1) for row in rows[seed])
    starts = [{tuple(row["T_w_m0"]) for row in found} for found in rows]
    assert not starts[0] & starts[1]
