"""The stage that trains the relative-pose network, from shards to weights, as the command runs it."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest
import safetensors.torch
import torch
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator
from typer.testing import CliRunner

from rendezvous.cli.__main__ import app
from rendezvous.errors import ConfigError, PipelineError, StoreError
from rendezvous.models.relative_pose_network import RelativePoseConfig, RelativePoseNet
from rendezvous.stages.pack import pack
from rendezvous.stages.train_pose import train_pose
from rendezvous.stages.training.train_record import CHECKPOINT, CURVE, WEIGHTS
from rendezvous.store.read import StageReader
from rendezvous.training.checkpoint import fit_weights_in_place, read_checkpoint, with_record
from rendezvous.training.published_rows import rows_per_split
from rendezvous.training.relative_pose.model import PoseModel
from tests.conftest import ROOT, run_in, wait_until
from tests.synthetic_dataset import POSE_ROWS, explored, rendered, synthetic_run

TINY = {"width": 16, "blocks": 0, "feature_channels": 8, "stages": 2, "stage_channels": 8, "stage_layers": 1}
SETS = (
    f"train_pose.settings={TINY}",
    "train_pose.sampling={input_px: 64, greatest_span_px: 60, close_span_px: 40}",
    "train_pose.optimisation={batch_size: 4}",
    "train_pose.minutes=null",
    "train_pose.samples=32",
    "train_pose.validations=4",
)


@pytest.fixture(autouse=True)
def _one_thread():
    torch.set_num_threads(1)


def trained(data: Path, out: Path, *overrides: str, resume: bool = False) -> str:
    """Train; what was said."""
    run = run_in(str(data), (*SETS, *overrides))
    train_pose(run, out=out, resume=resume)
    return run.console.file.getvalue()


def command(data: Path, out: Path, *more: str) -> list[str]:
    sets = [word for item in SETS for word in ("--set", item)]
    return ["train-pose", "--data", str(data), "--out", str(out), "--workers", "1", *sets, *more]


def curve_of(out: Path) -> list[dict[str, float]]:
    return json.loads((out / CURVE).read_text())["curve"]


def test_training_writes_weights_a_curve_and_events_and_says_on_what(data: Path, tmp_path: Path):
    images = rows_per_split(StageReader(str(data / "dataset"), "pack"), "poses")
    said = trained(data, tmp_path / "run")
    assert "calibrate: left out, " in said
    assert f"train relative-pose: poses of {data}/dataset: {images['train']} train, " in said
    assert [point["samples"] for point in curve_of(tmp_path / "run")] == [8, 16, 24, 32]
    assert all(0.0 <= point["keypoints_found"] <= 1.0 for point in curve_of(tmp_path / "run"))
    weights = read_checkpoint((tmp_path / "run" / WEIGHTS).read_bytes(), where="here")
    record = weights.record
    model = PoseModel(RelativePoseNet(RelativePoseConfig.from_dict(record["network"])))
    fit_weights_in_place(model, weights.tensors, where="here")
    assert (record["model"], record["samples"]) == ("relative-pose", 32)
    assert (record["sampling"]["input_px"], record["sampling"]["belief_sigma_cells"]) == (64, 1.0)
    assert record["robot"]["name"] == "scout"
    assert record["robot"]["size_m"] == [0.3, 0.2, 0.1]
    assert record["data"]["poses"]["train"] == images["train"]
    events = EventAccumulator(str(tmp_path / "run"), size_guidance={"images": 0}).Reload()
    assert [event.step for event in events.Scalars("curve/validation_loss")] == [8, 16, 24, 32]
    assert [event.step for event in events.Images("belief_maps")] == [8, 16, 24, 32]
    # Every tenth step is told, and there are eight.
    longer = trained(data, tmp_path / "longer", "train_pose.samples=40", "train_pose.validations=1")
    assert "10 steps" in longer
    events = EventAccumulator(str(tmp_path / "longer")).Reload()
    assert [event.step for event in events.Scalars("train/belief_2")] == [40]


def test_a_run_goes_on_to_the_same_curve_and_only_when_it_is_told_to(data: Path, tmp_path: Path):
    whole, halted = tmp_path / "whole", tmp_path / "halted"
    sets = ("train_pose.optimisation={batch_size: 4, final_share: 1.0, warmup_share: 0.0, precision: fp32}",)
    trained(data, whole, *sets)
    # With a rate that stays, half a budget is the first half of the whole.
    trained(data, halted, *sets, "train_pose.samples=16", "train_pose.validations=2")
    with pytest.raises(StoreError, match="a run is here already; --resume goes on with it"):
        trained(data, halted, *sets)
    assert "goes on from 16 samples" in trained(data, halted, *sets, resume=True)
    for mine, other in zip(curve_of(halted), curve_of(whole), strict=True):
        assert mine["samples"] == other["samples"]
        assert mine["training_loss"] == pytest.approx(other["training_loss"], rel=1e-4)
        assert mine["validation_loss"] == pytest.approx(other["validation_loss"], rel=1e-4)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ("train_pose.settings={widht: 3}", "relative-pose has no 'widht'; the nearest known is 'width'"),
        ("train_pose.settings={width: wide}", "train_pose.settings: width of relative-pose is 'wide'"),
        ("train_pose.settings={features: vgg16}", "features is 'vgg16'; must be vgg19 or small"),
        ("train_pose.samples=null", "train_pose.minutes and train_pose.samples are both null"),
        ("train_pose.initial_weights=gone.safetensors", "train_pose.initial_weights is gone.safetensors: "),
        ("train_pose.sampling={input_px: 150}", "input_px is 150; must be a multiple of 8"),
    ],
)
def test_wrong_settings_are_told_before_any_data_is_read(tmp_path: Path, change: str, said: str):
    with pytest.raises(ConfigError) as caught:
        trained(tmp_path / "no data", tmp_path / "run", change)
    assert said in str(caught.value)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ("train_pose.settings={stages: 1}", "begun with train_pose.settings.stages 2, now it is 1"),
        ("train_pose.sampling={close_share: 0.1}", "begun with train_pose.sampling.close_share 0.7, now"),
        ("seed=3", "begun with seed 0, now it is 3"),
    ],
)
def test_a_run_does_not_go_on_with_other_settings(data: Path, tmp_path: Path, change: str, said: str):
    trained(data, tmp_path, "train_pose.samples=8")
    with pytest.raises(ConfigError) as caught:
        trained(data, tmp_path, change, resume=True)
    assert said in str(caught.value)


def test_initial_weights_are_read_from_their_file(tmp_path: Path):
    path = tmp_path / "vgg19.safetensors"
    safetensors.torch.save_file({"features.0.weight": torch.zeros(64, 3, 3, 3)}, path)
    sets = ("train_pose.settings={features: vgg19}", f"train_pose.initial_weights={path}")
    with pytest.raises(ConfigError, match=r"vgg19.safetensors: features.0.bias is absent; must be of shape"):
        train_pose(run_in(str(tmp_path / "no data"), sets))
    path.write_bytes(path.read_bytes()[:-100])
    with pytest.raises(ConfigError, match="file: a trained network's weights, or torchvision's vgg19"):
        train_pose(run_in(str(tmp_path / "no data"), sets))


def test_floor_plans_of_the_weights_it_starts_from_count_as_seen(data: Path, tmp_path: Path):
    trained(data, tmp_path / "first", "train_pose.samples=8")
    first = read_checkpoint((tmp_path / "first" / WEIGHTS).read_bytes(), where="first")
    own = first.record["data"]["plan_digests"]
    other = first.record["data"] | {"plan_digests": ["feedfeedfeed"]}
    given = tmp_path / "given.safetensors"
    given.write_bytes(with_record(first, data=other))
    trained(data, tmp_path / "second", "train_pose.samples=8", f"train_pose.initial_weights={given}")
    second = read_checkpoint((tmp_path / "second" / WEIGHTS).read_bytes(), where="second")
    assert second.record["data"]["plan_digests"] == sorted([*own, "feedfeedfeed"])


def test_a_dataset_without_poses_is_one_line_and_exit_2(data: Path, tmp_path: Path):
    unsplit = tmp_path / "unsplit"
    unsplit.mkdir()
    (unsplit / "dataset").symlink_to(data / "explore")
    shown = CliRunner().invoke(app, command(unsplit, tmp_path / "run"))
    assert shown.exit_code == 2
    assert shown.stderr.count("\n") == 1
    assert "no poses in poses/train-*.parquet" in shown.stderr


def test_a_file_where_the_run_shall_be_is_told(data: Path, tmp_path: Path):
    taken = tmp_path / "taken"
    taken.write_text("a file")
    for out in (taken, taken / "run"):
        with pytest.raises(StoreError, match=r"taken.*: .*; --out must name a folder that can be written to"):
            trained(data, out)


def test_a_truncated_checkpoint_is_told(data: Path, tmp_path: Path):
    trained(data, tmp_path, "train_pose.samples=8")
    path = tmp_path / CHECKPOINT
    path.write_bytes(path.read_bytes()[:-100])
    with pytest.raises(PipelineError, match="no whole checkpoint"):
        trained(data, tmp_path, resume=True)


def test_weights_are_calibrated_when_training_ends(data: Path, tmp_path: Path, monkeypatch):
    calls = []
    monkeypatch.setattr("rendezvous.stages.train_pose.LEAST_ROWS", 1)
    monkeypatch.setattr(
        "rendezvous.stages.train_pose.calibrate_pose",
        lambda weights, dataset, **options: calls.append((weights.is_file(), weights, dataset)),
    )
    assert "calibrate: left out" not in trained(data, tmp_path, "train_pose.samples=8")
    assert calls == [(True, tmp_path / WEIGHTS, f"{data}/dataset")]


def test_a_network_that_finds_too_few_robots_is_left_uncalibrated(data: Path, tmp_path: Path, monkeypatch):
    monkeypatch.setattr("rendezvous.stages.train_pose.LEAST_ROWS", 1)
    said = trained(data, tmp_path, "train_pose.samples=8")
    assert "calibrate: left out, " in said
    assert (tmp_path / WEIGHTS).is_file()


def test_a_network_of_images_that_no_robot_takes_is_left_uncalibrated(tmp_path: Path, monkeypatch):
    monkeypatch.setattr("rendezvous.stages.train_pose.LEAST_ROWS", 1)
    freely = {"mode": "free", "T_r0_c": None, "T_r0_c_true": None}
    explored(tmp_path)
    poses = [[row | freely for row in plan] for plan in POSE_ROWS]
    rendered(tmp_path, views=False, poses=poses, parameters={"free": True})
    pack(synthetic_run(tmp_path, "pack.validation_fraction=0.1", "pack.test_fraction=0.1"))
    said = trained(tmp_path, tmp_path / "run", "train_pose.samples=8")
    assert "calibrate: left out, " in said
    assert "no plausible or sighting images of split validation" in said
    assert (tmp_path / "run" / WEIGHTS).is_file()


@pytest.mark.slow
def test_a_run_killed_at_any_time_goes_on_to_the_same_curve(data: Path, tmp_path: Path):
    sets = ("train_pose.samples=160", "train_pose.checkpoint_every_s=0.001")
    whole, killed = tmp_path / "whole", tmp_path / "killed"
    trained(data, whole, *sets)
    words = [word for item in sets for word in ("--set", item)]
    process = subprocess.Popen(
        [sys.executable, "-m", "rendezvous.cli", *command(data, killed, *words)],
        cwd=ROOT,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
    )
    wait_until(lambda: (killed / CURVE).exists() and bool(curve_of(killed)), process)
    os.killpg(process.pid, signal.SIGKILL)
    process.wait()
    assert "goes on from" in trained(data, killed, *sets, resume=True)
    for mine, other in zip(curve_of(killed), curve_of(whole), strict=True):
        assert mine["samples"] == other["samples"]
        assert mine["training_loss"] == pytest.approx(other["training_loss"], rel=1e-4)
        assert mine["validation_loss"] == pytest.approx(other["validation_loss"], rel=1e-4)
