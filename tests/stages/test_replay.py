"""`replay`: pairs out of recorded logs."""

import hashlib
import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from rendezvous.cli.__main__ import app
from rendezvous.errors import ConfigError, LogError, StoreError
from rendezvous.geometry.occupancy_grid import overlap
from rendezvous.geometry.se2 import SE2
from rendezvous.geometry.wall_agreement import wall_agreement
from rendezvous.schema import PAIRS, VIEWS
from rendezvous.stages.replay import replay
from rendezvous.store.read import StageReader
from rendezvous.training.frame_error.pairs import read_pairs
from tests.recorded.drive import carmen_text, driven

_DRIVE = driven(scans=80)
_SETTINGS = (
    "replay.pairs_per_log=6",
    "replay.stretches={length_m: [1.5, 4.0], distance_m: [0.4, 3.0]}",
    "replay.overlap=[0.05, 0.95]",
)


def _run(make_run, logs, *overrides, data=None):
    given = f"replay.logs={json.dumps(logs)}"
    return make_run([*_SETTINGS, given, *overrides], data=data)


@pytest.fixture(scope="module")
def log_file(tmp_path_factory):
    path = tmp_path_factory.mktemp("logs") / "drive.log"
    path.write_text(carmen_text(_DRIVE, head="NEFF 30\n"))
    return path


@pytest.fixture
def rows(make_run, log_file):
    run = _run(make_run, [{"path": str(log_file), "building": "hall"}])
    replay(run)
    (shard,) = run.read("replay").shards()
    return PAIRS.rows(run.read("replay").table(shard.name))


def test_rows_are_those_of_a_simulated_pair_without_image(rows):
    assert len(rows) == 6
    named = {c.name for c in VIEWS.columns} - {"pair_id", "plan_id"} | {"furniture_density"}
    for row in rows:
        assert {name for name, value in row.items() if value is None} == named
        assert row["plan_id"] == "hall"
        assert row["drive"] == "recorded"
        assert row["episode_id"].startswith("drive.log ")
        assert row["visible_fraction"] == 1.0
    assert len({row["pair_id"] for row in rows}) == 6


def test_the_label_is_the_truth(rows):
    for row in rows:
        ends = [int(way.split("-")[1]) for way in row["episode_id"].split()[2:]]
        T_w_r0, T_w_r1 = (SE2.from_array(_DRIVE.poses_w[end]) for end in ends)
        true = (T_w_r0.inverse() @ T_w_r1).wrapped().as_array()
        assert row["T_r0_r1_true"].as_array() == pytest.approx(true, abs=1e-5)
        starts = [int(way.split("-")[0]) for way in row["episode_id"].split()[2:]]
        T_w_m0, T_w_m1 = (SE2.from_array(_DRIVE.poses_w[start]) for start in starts)
        assert row["T_m0_m1"].as_array() == pytest.approx(
            (T_w_m0.inverse() @ T_w_m1).wrapped().as_array(), abs=1e-5
        )
        local = row["T_m0_r0"] @ row["T_r0_r1_true"] @ row["T_m1_r1"].inverse()
        assert row["T_m0_m1_local"].as_array() == pytest.approx(local.wrapped().as_array(), abs=1e-9)
        assert row["slam_position_error_0_m"] < 0.1
        centre_c = np.linalg.inv(row["T_r0_c"]) @ _se3(row["T_r0_r1_true"]) @ row["T_r1_o"][:, 3]
        assert abs(centre_c[0]) < 0.15 * centre_c[2]  # the camera faces robot 1


def _se3(pose):
    T = np.eye(4)
    T[:2, [0, 1, 3]] = pose.matrix()[:2]
    return T


def test_training_and_evaluation_read_the_pairs_and_the_maps_agree(make_run, log_file):
    run = _run(make_run, [{"path": str(log_file)}])
    replay(run)
    pairs = read_pairs(run.folder("replay"), "test")
    assert len(pairs) == 6
    for pair in (pairs[i] for i in range(6)):
        assert wall_agreement(pair.grid_0, pair.grid_1, pair.T_m0_m1).share > 0.85
        assert overlap(pair.grid_0, pair.grid_1, pair.T_m0_m1) == pytest.approx(pair.overlap)


def test_finished_logs_are_kept_and_a_changed_one_is_made_again(make_run, log_file, tmp_path):
    second = tmp_path / "other.log"
    second.write_text(carmen_text(_DRIVE, head="NEFF 31\n"))
    logs = [{"path": str(log_file)}, {"path": str(second)}]
    first = replay(_run(make_run, logs))
    run = _run(make_run, logs)
    assert replay(run) == first
    assert "0 made, 2 kept" in run.console.file.getvalue()
    moved = tmp_path / "elsewhere" / "drive.log"
    moved.parent.mkdir()
    shutil.copy(log_file, moved)
    second.write_text(carmen_text(_DRIVE, head="NEFF 32\n"))
    again = _run(make_run, [{"path": str(moved)}, {"path": str(second)}])
    replay(again)
    assert "1 made, 1 kept" in again.console.file.getvalue()


def test_the_card_lists_the_logs_with_their_digests(make_run, log_file):
    run = _run(make_run, [{"path": str(log_file), "building": "hall"}])
    replay(run)
    card = Path(run.folder("replay"), "README.md").read_text()
    digest = hashlib.sha256(log_file.read_bytes()).hexdigest()
    assert f"| `drive.log` | hall | test | 6 | `{digest}` |" in card
    assert "path: pairs/test-*.parquet" in card
    assert Path(run.folder("replay"), "pairs.png").stat().st_size > 10_000


def test_splits_go_by_building(make_run, log_file, tmp_path):
    logs = []
    for number in range(8):
        path = tmp_path / f"visit-{number}.log"
        path.write_text(carmen_text(_DRIVE, head=f"NEFF {number}\n"))
        logs.append({"path": str(path), "building": f"house-{number // 2}"})
    run = _run(make_run, logs, "replay.pairs_per_log=1", "replay.test_fraction=0.5")
    replay(run)
    reader = StageReader(run.folder("replay"))
    of_split = {
        split: {
            plan
            for shard in reader.shards(f"pairs/{split}")
            for plan in reader.table(shard.name, columns=["plan_id"])["plan_id"].to_pylist()
        }
        for split in ("train", "test")
    }
    assert of_split["train"]
    assert of_split["test"]
    assert not of_split["train"] & of_split["test"]
    assert len(of_split["train"] | of_split["test"]) == 4


def test_a_log_that_cannot_be_used_is_left_out_with_its_reason(make_run, log_file, tmp_path):
    raw = tmp_path / "raw.log"
    raw.write_text(carmen_text(_DRIVE))
    run = _run(make_run, [{"path": str(log_file)}, {"path": str(raw)}])
    manifest = replay(run)
    assert manifest.rows == 6
    (left_out,) = manifest.quarantined
    assert "no reference poses, so nothing says where two stretches meet" in left_out.reason
    with pytest.raises(LogError, match=r"1 logs have no pairs, the first: raw: .*no reference poses"):
        replay(_run(make_run, [{"path": str(raw)}], data=str(tmp_path / "alone")))


def test_a_folder_of_simulated_pairs_is_not_overwritten(make_run, log_file, tmp_path):
    run = _run(make_run, [{"path": str(log_file)}])
    replay(run)
    manifest = tmp_path / "data" / "dataset" / "manifest.json"
    manifest.write_text(manifest.read_text().replace('"stage": "replay"', '"stage": "pack"'))
    with pytest.raises(
        StoreError, match=r"holds the dataset that `rendezvous pack` made; .* --data names it"
    ):
        replay(_run(make_run, [{"path": str(log_file)}]))


def test_what_is_missing_is_one_line(make_run, log_file, tmp_path):
    with pytest.raises(ConfigError, match="replay: no log; name CARMEN logs or ROS bags"):
        replay(_run(make_run, []))
    with pytest.raises(LogError, match=r"none.log: no such file or directory; must be a recorded log"):
        replay(_run(make_run, [{"path": str(tmp_path / "none.log")}]))
    with pytest.raises(ConfigError, match="have one name; rename one"):
        replay(_run(make_run, [{"path": str(log_file)}, {"path": str(log_file)}]))


def test_no_meeting_is_one_line(make_run, log_file):
    with pytest.raises(
        LogError, match=r"no pair in 300 draws \(300 had no one in sight or too short a way, 0 "
    ):
        replay(_run(make_run, [{"path": str(log_file)}], "replay.stretches.length_m=[90.0, 99.0]"))


def test_the_command_takes_logs(log_file, tmp_path):
    sets = [word for setting in _SETTINGS for word in ("--set", setting)]
    arguments = ["replay", str(log_file), "--data", str(tmp_path), "--engine", "inline", *sets]
    result = CliRunner().invoke(app, arguments, catch_exceptions=False)
    assert result.exit_code == 0
    assert len(read_pairs(str(tmp_path / "dataset"), "test")) == 6
