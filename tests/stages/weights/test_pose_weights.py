"""Weights of the relative pose: what loads, what does not, and their calibration as the command does it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pytest
import torch
from typer.testing import CliRunner

from rendezvous.cli.__main__ import app
from rendezvous.errors import ConfigError, StoreError
from rendezvous.pose_estimation.pose_calibration import PoseCalibration
from rendezvous.stages.pack import pack
from rendezvous.stages.weights.pose_source import PoseWeights
from rendezvous.stages.weights.trained_estimators import load_relative_pose
from rendezvous.training.checkpoint import read_checkpoint, weights_bytes
from rendezvous.training.loop import TrainingState
from rendezvous.training.parameters import Optimisation
from rendezvous.training.relative_pose.model import build_pose_model
from rendezvous.training.relative_pose.sampling import PoseSampling
from tests.pose_estimation.observations import CAMERA, observation
from tests.synthetic_dataset import explored, synthetic_run

SETTINGS = {"width": 16, "blocks": 0, "feature_channels": 8, "stage_channels": 8}
ROBOT = {"name": "scout", "size_m": [0.1, 0.2, 0.3], "T_r1_o": np.eye(4).tolist()}
MATCHER = Path(__file__).parents[3] / "assets" / "weights" / "matcher.safetensors"


def weights(**told: object) -> bytes:
    torch.set_num_threads(1)
    model = build_pose_model(SETTINGS, seed=0)
    about = {
        "model": "relative-pose",
        "network": model.config(),
        "sampling": asdict(PoseSampling(close_span_px=72.0)),
        "robot": ROBOT,
        **told,
    }
    return weights_bytes(TrainingState.fresh(model, Optimisation()), about)


OTHER_NETWORK = build_pose_model(SETTINGS | {"width": 32}, seed=0).config()


def test_weights_tell_all_that_the_estimator_needs():
    calibration = PoseCalibration(along_share=0.07)
    found = load_relative_pose(weights(calibration=calibration.as_dict()), where="here")
    assert found.robot.size_m == (0.1, 0.2, 0.3)
    assert found.robot.T_r1_o == pytest.approx(np.eye(4))
    assert found.close.span_px == 72.0
    assert found.calibration == calibration
    assert not found.network.training
    assert load_relative_pose(weights(), where="here").calibration == PoseCalibration()
    assert found(np.zeros((480, 640, 3), np.uint8), CAMERA, observation().T_r0_c).reason


def _changed(**told: object) -> Callable[[], bytes]:
    return lambda: weights(**told)


@pytest.mark.parametrize(
    ("data", "error", "told"),
    [
        (MATCHER.read_bytes, ConfigError, "weights of 'matcher'; must be those of 'relative-pose'"),
        (lambda: weights()[:-100], StoreError, "here: .* bytes that are no whole checkpoint"),
        (lambda: b"", StoreError, "0 bytes that are no whole checkpoint"),
        (_changed(robot={"name": "scout"}), ConfigError, "wrong or missing entry .*size_m"),
        (_changed(sampling=None), ConfigError, "wrong or missing entry"),
        (_changed(network={"width": 32}), ConfigError, "^here: .*wrong or missing entry .*blocks is absent"),
        (_changed(network=OTHER_NETWORK), ConfigError, "weights do not fit the model"),
        (_changed(calibration={"bias": 1.0}), ConfigError, "calibration holds"),
    ],
)
def test_other_weights_are_told_in_one_line(data, error, told):
    with pytest.raises(error, match=told) as raised:
        load_relative_pose(data(), where="here")
    assert "\n" not in str(raised.value)


def test_missing_weights_name_the_command_that_makes_them(tmp_path):
    with pytest.raises(StoreError, match=r"none\.safetensors: no weights .*`rendezvous train-pose`"):
        PoseWeights.found(tmp_path / "none.safetensors")


@pytest.fixture(scope="module")
def data(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("published")
    explored(folder)
    pack(synthetic_run(folder, "pack.validation_fraction=0.4"))
    return folder


def _called(path: Path, data: Path) -> tuple[int, str]:
    result = CliRunner().invoke(app, ["calibrate-pose", str(path), "--data", str(data), "--workers", "1"])
    return result.exit_code, result.output + str(result.exception or "")


def test_a_network_that_finds_nothing_is_not_calibrated(data, tmp_path):
    path = tmp_path / "weights.safetensors"
    path.write_bytes(weights())
    before = path.read_bytes()
    code, told = _called(path, data)
    assert code != 0
    assert "a calibration needs 20" in told
    assert path.read_bytes() == before


def test_a_calibration_is_kept_with_the_weights(data, tmp_path, monkeypatch):
    calibration = PoseCalibration(sharpness=0.3)
    monkeypatch.setattr(
        "rendezvous.stages.training.calibrate_pose._calibration", lambda *_: (calibration, 7), raising=True
    )
    path = tmp_path / "weights.safetensors"
    # Whatever an earlier calibration said, be it of use or not.
    path.write_bytes(weights(seed=3, calibration={"of": "another version"}))
    before = read_checkpoint(path.read_bytes(), where="before")
    code, told = _called(path, data)
    assert code == 0, told
    assert "the robot found in 7" in told
    after = read_checkpoint(path.read_bytes(), where="after")
    assert load_relative_pose(path.read_bytes(), where="after").calibration == calibration
    assert after.record["calibrated_on"]["found"] == 7
    assert all(torch.equal(after.tensors[name], tensor) for name, tensor in before.tensors.items())
    assert {**after.record, "calibration": 0, "calibrated_on": 0} == {
        **before.record,
        "calibration": 0,
        "calibrated_on": 0,
    }
