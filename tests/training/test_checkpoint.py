"""Checkpoints: whole, or told apart from it."""

from __future__ import annotations

import pytest
import safetensors.torch
import torch

from rendezvous.errors import ConfigError, StoreError
from rendezvous.training.checkpoint import (
    checkpoint_bytes,
    fit_weights_in_place,
    read_checkpoint,
    restore_in_place,
    weights_bytes,
)
from rendezvous.training.frame_error.registry import FrameErrorPoint
from rendezvous.training.loop import TrainingState
from rendezvous.training.parameters import Optimisation
from tests.training.tiny import TinyModel, tiny_model

POINT = FrameErrorPoint(
    samples=8,
    elapsed_s=1.5,
    training_loss=0.5,
    validation_loss=0.25,
    error_x_m=0.1,
    error_y_m=0.2,
    error_yaw_rad=0.3,
)


@pytest.fixture
def state() -> TrainingState:
    """After one step."""
    state = TrainingState.fresh(tiny_model(), Optimisation())
    state.model.layers(torch.ones(1, 288)).sum().backward()
    state.optimizer.step()
    state.step, state.samples, state.elapsed_s, state.curve = 1, 8, 2.5, [POINT]
    return state


def test_what_is_written_is_read(state: TrainingState):
    checkpoint = read_checkpoint(checkpoint_bytes(state, {"model": "tiny"}), where="here")
    other = TrainingState.fresh(tiny_model(seed=1), Optimisation())
    restore_in_place(other, checkpoint, where="here")
    assert checkpoint.record["model"] == "tiny"
    assert (other.step, other.samples, other.elapsed_s, other.curve) == (1, 8, 2.5, [POINT])
    for mine, theirs in ((other.model, state.model), (other.average, state.average)):
        assert all(torch.equal(mine.state_dict()[k], v) for k, v in theirs.state_dict().items())
    assert not torch.equal(other.model.layers[0].weight, other.average.layers[0].weight)
    mine, theirs = (s.optimizer.state_dict()["state"] for s in (other, state))
    assert mine.keys() == theirs.keys()
    assert all(torch.equal(mine[i][k], v) for i, values in theirs.items() for k, v in values.items())


def test_weights_are_the_average(state: TrainingState):
    weights = read_checkpoint(weights_bytes(state, {}), where="here")
    model = tiny_model(seed=1)
    fit_weights_in_place(model, weights.tensors, where="here")
    assert torch.equal(model.layers[0].weight, state.average.layers[0].weight)


@pytest.mark.parametrize("kept", [0.0, 0.001, 0.01, 0.2, 0.5, 0.999])
def test_a_truncated_checkpoint_is_told_in_one_line(state: TrainingState, kept: float):
    data = checkpoint_bytes(state, {})
    with pytest.raises(StoreError, match=r"^there: \d+ bytes that are no whole checkpoint") as caught:
        read_checkpoint(data[: int(kept * len(data))], where="there")
    assert "\n" not in str(caught.value)


def test_a_file_of_another_program_is_told():
    import safetensors.torch

    data = safetensors.torch.save({"a": torch.zeros(2)})
    with pytest.raises(StoreError, match="no whole checkpoint"):
        read_checkpoint(data, where="there")


def test_weights_that_do_not_fit_are_told_with_the_first_that_differs(state: TrainingState):
    weights = read_checkpoint(weights_bytes(state, {}), where="here").tensors
    wider = TinyModel()
    wider.layers[0] = torch.nn.Linear(288, 32)
    with pytest.raises(ConfigError, match=r"layers.0.bias is of shape \(16,\); must be of shape \(32,\)"):
        fit_weights_in_place(wider, weights, where="there")
    with pytest.raises(ConfigError, match=r"^there: .*layers.3.bias is absent; must be of shape \(3,\)"):
        fit_weights_in_place(
            tiny_model(), {k: v for k, v in weights.items() if k != "layers.3.bias"}, where="there"
        )


def test_weights_of_another_format_are_told(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("rendezvous.training.checkpoint._FORMAT", 1)
    old = weights_bytes(TrainingState.fresh(tiny_model(), Optimisation()), {"model": "tiny"})
    monkeypatch.undo()
    with pytest.raises(StoreError, match="format 1; must be 2"):
        read_checkpoint(old, where="w.safetensors")


@pytest.mark.parametrize("record", ["[]", "1", "null", '"x"', "[" * 100_000, "{}", '{"format": NaN}'])
def test_a_record_of_another_kind_is_one_line(record: str):
    data = safetensors.torch.save({"a": torch.zeros(1)}, metadata={"rendezvous": record})
    with pytest.raises(StoreError, match=r"\Ahere: [^\n]*train anew"):
        read_checkpoint(data, where="here")


@pytest.mark.parametrize(
    "told",
    [
        {"step": None}, {"step": "1"}, {"step": -1}, {"samples": 1.5}, {"elapsed_s": []}, {"curve": 1},
        {"curve": [1]}, {"curve": [{}]}, {"curve": [{"samples": 1, "more": 2}]},
    ],
)  # fmt: skip
def test_a_run_with_a_wrong_record_is_not_resumed(state: TrainingState, told: dict[str, object]):
    checkpoint = read_checkpoint(checkpoint_bytes(state, {}), where="here")
    checkpoint.record.update(told)
    with pytest.raises(StoreError, match=r"\Ahere: its record of the run has a wrong or missing entry \("):
        restore_in_place(TrainingState.fresh(tiny_model(), Optimisation()), checkpoint, where="here")
