"""The stage that trains, from published shards to weights, as the command runs it."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator
from typer.testing import CliRunner

from rendezvous.cli.__main__ import app
from rendezvous.errors import ConfigError, PipelineError, StoreError
from rendezvous.stages.train import train
from rendezvous.stages.training.train_record import CHECKPOINT, CURVE, WEIGHTS
from rendezvous.store.disk import Disk
from rendezvous.training.checkpoint import fit_weights_in_place, read_checkpoint, with_record
from rendezvous.training.frame_error.registry import rebuilt_model
from rendezvous.training.parameters import Sampling
from tests.conftest import ROOT, run_in, wait_until

SMALL = {"cells": 48, "width": 16, "depth": 1, "heads": 2}
SETS = (
    "train.model=cnn-lie",
    f"train.settings={SMALL}",
    "train.sampling={window_cells: 48, window_cell_m: 0.4}",
    "train.optimisation={batch_size: 4}",
    "train.minutes=null",
    "train.samples=32",
    "train.validations=4",
)


def trained(data: Path, out: Path, *overrides: str, resume: bool = False) -> str:
    """Train; what was said."""
    run = run_in(str(data), (*SETS, *overrides))
    train(run, out=out, resume=resume)
    return run.console.file.getvalue()


def command(data: Path, out: Path, *more: str) -> list[str]:
    sets = [word for item in SETS for word in ("--set", item)]
    return ["train", "--data", str(data), "--out", str(out), "--workers", "1", *sets, *more]


def curve_of(out: Path) -> list[dict[str, float]]:
    return json.loads((out / CURVE).read_text())["curve"]


def test_training_writes_weights_a_curve_and_events_and_says_on_what(data: Path, tmp_path: Path):
    said = trained(data, tmp_path / "run")
    assert "train cnn-lie: " in said
    assert f"pairs of {data}/dataset: 12 train, 4 validation, 4 test; 6 plans to train on" in said
    assert "made with seed 0, digest " in said
    assert [point["samples"] for point in curve_of(tmp_path / "run")] == [8, 16, 24, 32]
    assert all(0.0 < point["error_x_m"] < 4.0 for point in curve_of(tmp_path / "run"))
    assert list((tmp_path / "run").glob("events.out.tfevents.*"))
    weights = read_checkpoint((tmp_path / "run" / WEIGHTS).read_bytes(), where="here")
    sampling = Sampling(window_cells=48, window_cell_m=0.4)
    model = rebuilt_model(weights.record["model"], weights.record["network"], sampling)
    fit_weights_in_place(model, weights.tensors, where="here")
    assert weights.record["samples"] == 32
    assert weights.record["data"]["pairs"] == {"train": 12, "validation": 4}
    assert f"digest {weights.record['data']['digest'][:12]}\n" in said


def test_how_fast_it_goes_and_how_long_it_will_take_is_told(data: Path, tmp_path: Path, monkeypatch):
    monkeypatch.setattr("rendezvous.stages.training.train_record.LINE_EVERY_S", 0.0)
    write, saved = Disk.write, list[str]()
    monkeypatch.setattr(Disk, "write", lambda *given: (saved.append(given[1]), write(*given)))
    told = re.findall(
        r"train cnn-lie: (\d+) samples, [\d.]+/s, loss [\d.e+-]+, (\d+) % done, about (\d+) s left",
        trained(data, tmp_path, "train.checkpoint_every_s=1e-6"),
    )
    assert saved == [WEIGHTS, CURVE, CHECKPOINT] * 8  # after each step
    assert [(int(samples), int(done)) for samples, done, _ in told] == [
        (samples, round(100 * samples / 32)) for samples in range(8, 33, 4)
    ]
    assert told[-1][2] == "0"


def test_a_run_goes_on_only_when_it_is_told_to(data: Path, tmp_path: Path):
    trained(data, tmp_path, "train.samples=16")
    with pytest.raises(StoreError, match="a run is here already; --resume goes on with it"):
        trained(data, tmp_path)
    said = trained(data, tmp_path, resume=True)
    assert "goes on from 16 samples" in said
    assert curve_of(tmp_path)[-1]["samples"] == 32
    assert "8 steps" in trained(data, tmp_path, resume=True)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (
            "train.optimisation={batch_size: 2}",
            r"begun with train.optimisation.batch_size 4, now it is 2",
        ),
        ("train.model=cnn", "begun with train.model cnn-lie, now it is cnn"),
        ("seed=3", "begun with seed 0, now it is 3"),
    ],
)
def test_a_run_does_not_go_on_with_other_settings(data: Path, tmp_path: Path, change: str, said: str):
    trained(data, tmp_path, "train.samples=8")
    with pytest.raises(ConfigError, match=said):
        trained(data, tmp_path, change, resume=True)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ("train.model=matchr", "train.model is 'matchr'; must be one of matcher, cnn, cnn-lie"),
        ("train.settings={widht: 3}", "cnn-lie has no 'widht'; the nearest known is 'width'"),
        ("train.settings={width: wide}", "width of cnn-lie is 'wide'; must be like 256"),
        ("train.settings={cells: 96, width: 32}", "cells is 96; must divide the window's 48"),
        ("train.samples=null", "train.minutes and train.samples are both null"),
    ],
)
def test_wrong_settings_are_told(data: Path, tmp_path: Path, change: str, said: str):
    with pytest.raises(ConfigError) as caught:
        # As an override of its own, `settings` is laid over the others.
        trained(data, tmp_path, change)
    assert said in str(caught.value)
    assert not (tmp_path / CHECKPOINT).exists()


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ("train.settings={heads: 0}", "train.settings: FrameErrorConfig: heads is 0"),
        ("train.sampling.window_cells=102", "cells is 48; must divide the window's 102 cells"),
        ("train.samples=null", "train.minutes and train.samples are both null"),
    ],
)
def test_wrong_settings_are_told_before_any_data_is_read(tmp_path: Path, change: str, said: str):
    with pytest.raises(ConfigError, match=re.escape(said)):
        trained(tmp_path / "no data", tmp_path / "run", change)


def test_other_data_leave_a_new_folder_or_the_old_ones_end(data: Path, tmp_path: Path):
    trained(data, tmp_path, "train.samples=8")
    path = tmp_path / CHECKPOINT
    found = read_checkpoint(path.read_bytes(), where="here")
    now = found.record["data"]
    path.write_bytes(with_record(found, data={**now, "digest": "0" * 64}))
    with pytest.raises(
        ConfigError, match=f"begun with data {'0' * 12}, now it is {now['digest'][:12]};"
    ) as caught:
        trained(data, tmp_path, resume=True)
    assert "another folder with --out (make: OUT=FOLDER) or delete this one" in str(caught.value)


def test_weights_tell_their_curve_though_the_disk_fails_after_them(data: Path, tmp_path: Path, monkeypatch):
    write = Disk.write

    def full_at_the_second_curve(disk: Disk, name: str, content: bytes) -> None:
        if name == CURVE and (tmp_path / CURVE).exists():
            raise StoreError("the disk is full")
        write(disk, name, content)

    monkeypatch.setattr(Disk, "write", full_at_the_second_curve)
    with pytest.raises(StoreError, match="the disk is full"):
        trained(data, tmp_path)
    record = read_checkpoint((tmp_path / WEIGHTS).read_bytes(), where="here").record
    assert [point["samples"] for point in curve_of(tmp_path)] == [8]
    assert [point["samples"] for point in record["curve"]] == [8, 16]
    assert record["samples"] == 16
    monkeypatch.undo()
    trained(data, tmp_path, resume=True)
    record = read_checkpoint((tmp_path / WEIGHTS).read_bytes(), where="here").record
    assert [point["samples"] for point in curve_of(tmp_path)] == [8, 16, 24, 32]
    assert record["curve"] == curve_of(tmp_path)


def test_a_resumed_run_drops_the_events_after_its_checkpoint(data: Path, tmp_path: Path):
    def train_as(number: int, *overrides: str) -> None:
        trained(data, tmp_path, *overrides, resume=True)
        # TensorBoard reads files in the order of their names, which begin with the second.
        (newest,) = tmp_path.glob("events.out.tfevents.*.*")
        newest.rename(tmp_path / f"events.out.tfevents.{number}")

    train_as(0, "train.samples=16")
    early = (tmp_path / CHECKPOINT).read_bytes()
    train_as(1)
    (tmp_path / CHECKPOINT).write_bytes(early)
    train_as(2)
    events = EventAccumulator(str(tmp_path)).Reload()
    assert [event.step for event in events.Scalars("curve/error_x_m")] == [4, 8, 12, 16, 24, 32]


def test_shards_without_splits_are_one_line_and_exit_2(data: Path, tmp_path: Path):
    unsplit = tmp_path / "unsplit"
    unsplit.mkdir()
    (unsplit / "dataset").symlink_to(data / "explore")
    shown = CliRunner().invoke(app, command(unsplit, tmp_path / "run"))
    assert shown.exit_code == 2
    assert shown.stderr.count("\n") == 1
    assert "no pairs in pairs/train-*.parquet" in shown.stderr


def test_a_truncated_checkpoint_is_one_line_and_exit_2(data: Path, tmp_path: Path):
    trained(data, tmp_path, "train.samples=8")
    path = tmp_path / CHECKPOINT
    path.write_bytes(path.read_bytes()[:-100])
    shown = CliRunner().invoke(app, command(data, tmp_path, "--resume"))
    assert shown.exit_code == 2
    assert shown.stderr.count("\n") == 1
    assert f"{path}: " in shown.stderr
    assert "no whole checkpoint" in shown.stderr


def test_a_checkpoint_of_other_weights_is_told(data: Path, tmp_path: Path):
    trained(data, tmp_path, "train.samples=8")
    found = read_checkpoint((tmp_path / CHECKPOINT).read_bytes(), where="here")
    tensors = found.tensors | {"model.network.head.mlp.2.bias": torch.zeros(4)}
    (tmp_path / CHECKPOINT).write_bytes(with_record(replace(found, tensors=tensors)))
    with pytest.raises(PipelineError, match=r"network.head.mlp.2.bias is of shape \(4,\); must be of"):
        trained(data, tmp_path, resume=True)


@pytest.mark.slow
def test_a_run_killed_at_any_time_goes_on_to_the_same_curve(data: Path, tmp_path: Path):
    sets = ("train.samples=160", "train.checkpoint_every_s=0.001")
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
        elapsed_s = {"elapsed_s": pytest.approx(mine["elapsed_s"])}
        assert mine == {k: pytest.approx(v, abs=1e-6) for k, v in other.items()} | elapsed_s


@pytest.mark.slow
def test_two_processes_find_what_one_finds_in_batches_twice_as_large(data: Path, tmp_path: Path):
    sets = ("--set", "train.optimisation={precision: fp32}", "--set", "train.samples=64")
    torchrun = [sys.executable, "-m", "torch.distributed.run", "--standalone", "--nproc-per-node", "2"]
    both = subprocess.run(
        [*torchrun, "-m", "rendezvous.cli", *command(data, tmp_path / "two", *sets)],
        cwd=ROOT,
        capture_output=True,
        text=True,
        env=os.environ | {"OMP_NUM_THREADS": "1"},
    )
    assert both.returncode == 0, both.stderr[-2000:]
    trained(
        data,
        tmp_path / "one",
        "train.optimisation={precision: fp32, batch_size: 8}",
        "train.samples=64",
    )
    two, one = curve_of(tmp_path / "two"), curve_of(tmp_path / "one")
    assert [point["samples"] for point in two] == [16, 32, 48, 64]
    for mine, other in zip(two, one, strict=True):
        assert mine["training_loss"] == pytest.approx(other["training_loss"], rel=1e-4)
        assert mine["error_x_m"] == pytest.approx(other["error_x_m"], rel=1e-4)


def test_a_matcher_is_calibrated_when_its_training_ends(data, tmp_path, monkeypatch):
    small = (
        "train.model=matcher",
        "train.settings={channels: 8, dilations: [1]}",
        "train.minutes=null",
        "train.samples=8",
        "train.validations=1",
        "train.validation_pairs=2",
    )

    def said(name: str, *overrides: str) -> str:
        run = run_in(str(data), (*small, *overrides))
        train(run, out=tmp_path / name)
        return run.console.file.getvalue()

    fine = "train.sampling={window_cells: 96, window_cell_m: 0.05}"
    assert "calibrate: left out" in said("few", fine)
    monkeypatch.setattr("rendezvous.stages.train.LEAST_PAIRS", 1)
    monkeypatch.setattr("rendezvous.stages.training.calibrate.LEAST_PAIRS", 1)
    coarse = "train.sampling={window_cells: 48, window_cell_m: 0.4}"
    assert "trained on cells of 0.4 m; it takes 0.05 m" in said("coarse", coarse)
    assert "calibrate: on " in said("out", fine)
    record = read_checkpoint((tmp_path / "out" / WEIGHTS).read_bytes(), where="out").record
    assert record["calibrated_on"]["pairs"] >= 1
