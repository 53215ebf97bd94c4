"""Calibration of trained weights, as the command does it."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path

import pytest
import torch
from typer.testing import CliRunner

from rendezvous.alignment.window import SearchRange
from rendezvous.cli.__main__ import app
from rendezvous.models.matcher_calibration import MatcherCalibration
from rendezvous.stages.pack import pack
from rendezvous.stages.training import calibrate
from rendezvous.stages.weights.trained_estimators import load
from rendezvous.training.checkpoint import read_checkpoint, weights_bytes, with_record
from rendezvous.training.frame_error.registry import build_model
from rendezvous.training.loop import TrainingState
from rendezvous.training.parameters import Optimisation, Sampling
from tests.synthetic_dataset import explored, synthetic_run

SETTINGS = {
    "matcher": {"channels": 8, "dilations": [1]},
    "cnn": {"cells": 48, "width": 16, "depth": 1, "heads": 2},
}


@pytest.fixture(scope="module")
def data(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("published")
    explored(folder)
    pack(synthetic_run(folder, "pack.validation_fraction=0.4"))
    return folder


def _weights(folder: Path, name: str) -> Path:
    torch.set_num_threads(1)
    model = build_model(name, SETTINGS[name], Sampling(), seed=0)
    about = {"model": name, "network": model.config(), "sampling": asdict(Sampling()), "seed": 0}
    path = folder / "weights.safetensors"
    path.write_bytes(weights_bytes(TrainingState.fresh(model, Optimisation()), about))
    return path


def _called(weights: Path, data: Path) -> tuple[int, str]:
    result = CliRunner().invoke(app, ["calibrate", str(weights), "--data", str(data), "--workers", "1"])
    return result.exit_code, result.output + str(result.exception or "")


def test_weights_are_kept_and_a_calibration_is_added(data, tmp_path, monkeypatch):
    monkeypatch.setattr(calibrate, "LEAST_PAIRS", 3)
    weights = _weights(tmp_path, "matcher")
    before = read_checkpoint(weights.read_bytes(), where="before")
    code, told = _called(weights, data)
    assert code == 0, told
    after = read_checkpoint(weights.read_bytes(), where="after")
    assert all(torch.equal(after.tensors[name], tensor) for name, tensor in before.tensors.items())
    assert {k: v for k, v in after.record.items() if not k.startswith("calibra")} == before.record
    found = MatcherCalibration.from_dict(after.record["calibration"])
    assert found != MatcherCalibration()
    assert after.record["calibrated_on"]["pairs"] >= 3
    search = SearchRange(xy_m=1.0, yaw_rad=0.3)
    assert load(weights.read_bytes(), "matcher", search, where="w", threads=1).estimator.calibration == found
    # Once more it starts from the scores, not from what was found before, be that of use or not.
    weights.write_bytes(with_record(after, calibration={"of": "another version"}))
    assert _called(weights, data)[0] == 0
    assert read_checkpoint(weights.read_bytes(), where="again").record == after.record


def test_too_few_pairs_and_other_weights_are_told(data, tmp_path):
    weights = _weights(tmp_path, "matcher")
    before = weights.read_bytes()
    code, told = _called(weights, data)
    assert code != 0
    assert "a calibration needs 20" in told
    assert weights.read_bytes() == before
    assert "must be those of 'matcher'" in _called(_weights(tmp_path, "cnn"), data)[1]
    assert "no such file; must be weights that `rendezvous train` writes" in _called(tmp_path / "no", data)[1]
