"""Weights whose record or numbers are not what `train` wrote are one line with the file's name."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

import pytest
import torch

from rendezvous.alignment.window import DEFAULT_SEARCH
from rendezvous.errors import PipelineError
from rendezvous.models.config import Config
from rendezvous.stages.weights.trained_estimators import load, load_relative_pose
from rendezvous.training.checkpoint import weights_bytes
from rendezvous.training.frame_error.registry import build_model
from rendezvous.training.loop import TrainingState
from rendezvous.training.parameters import Optimisation, Sampling
from tests.stages.weights.test_pose_weights import weights as pose_weights

SAMPLING = Sampling()
MATCHER = build_model("matcher", {}, SAMPLING, seed=0)
RECORD = {"model": "matcher", "network": MATCHER.config(), "sampling": asdict(SAMPLING)}


def matcher_weights(**told: object) -> bytes:
    return weights_bytes(TrainingState.fresh(MATCHER, Optimisation()), {**RECORD, **told})


def without(key: str) -> bytes:
    about = {name: value for name, value in RECORD.items() if name != key}
    return weights_bytes(TrainingState.fresh(MATCHER, Optimisation()), about)


def huge(config: Config | dict[str, Any], value: object) -> dict[str, Any]:
    """Each whole number of a network's config, replaced."""
    fields = dict(config) if isinstance(config, dict) else config.as_dict()
    whole = [key for key, old in fields.items() if isinstance(old, int) and not isinstance(old, bool)]
    return fields | dict.fromkeys(whole, value)


@pytest.mark.parametrize(
    ("key", "value"),
    [
        *((key, value) for key in ("network", "sampling") for value in (None, 1, "x", [], [[]])),
        ("network", {}),
        ("network", {"x": 1}),
    ],
)
def test_a_record_of_another_kind_is_one_line(key: str, value: object):
    for data, read in (
        (
            matcher_weights(**{key: value}),
            lambda d: load(d, "matcher", DEFAULT_SEARCH, where="w.st", threads=1),
        ),
        (pose_weights(**{key: value}), lambda d: load_relative_pose(d, where="w.st")),
    ):
        with pytest.raises(PipelineError, match=r"\Aw\.st: [^\n]*train anew\Z"):
            read(data)


@pytest.mark.parametrize(
    "told", [{"robot": {}}, {"robot": None}, {"robot": {"name": 1, "size_m": [1, 1, 1]}}]
)
def test_a_robot_that_is_none_is_one_line(told: dict[str, object]):
    with pytest.raises(PipelineError, match=r"\Aw\.st: its record of the training has a wrong or missing"):
        load_relative_pose(pose_weights(**told), where="w.st")


@pytest.mark.parametrize(
    "told", [{"calibration": {}}, {"calibration": 1}, {"data": []}, {"data": {"plan_digests": [1]}}]
)
def test_a_calibration_or_data_of_another_kind_is_one_line(told: dict[str, object]):
    for data, read in (
        (matcher_weights(**told), lambda d: load(d, "matcher", DEFAULT_SEARCH, where="w.st", threads=1)),
        (pose_weights(**told), lambda d: load_relative_pose(d, where="w.st")),
    ):
        with pytest.raises(PipelineError, match=r"\Aw\.st: [^\n]*\Z"):
            read(data)


@pytest.mark.parametrize("value", [0, -1, 2, 9_999, 10**9])
def test_a_network_that_the_weights_are_not_of_takes_no_memory(value: int):
    with pytest.raises(PipelineError, match=r"\Aw\.st: "):
        load(
            matcher_weights(network=huge(RECORD["network"], value)),
            "matcher", DEFAULT_SEARCH, where="w.st", threads=1,
        )  # fmt: skip


def test_a_record_without_an_entry_names_it():
    for key in ("network", "sampling"):
        with pytest.raises(PipelineError, match=rf"\Aw\.st: .*'{key}'.*train anew\Z"):
            load(without(key), "matcher", DEFAULT_SEARCH, where="w.st", threads=1)


@pytest.mark.parametrize("value", [float("nan"), float("inf")])
def test_a_weight_that_is_no_number_is_named(value: float):
    model = build_model("matcher", {}, SAMPLING, seed=0)
    state = TrainingState.fresh(model, Optimisation())
    name, weight = next(iter(state.average.named_parameters()))
    with torch.no_grad():
        weight.view(-1)[0] = value
    with pytest.raises(PipelineError, match=rf"\Aw\.st: {name} holds NaN or infinity"):
        load(weights_bytes(state, RECORD), "matcher", DEFAULT_SEARCH, where="w.st", threads=1)
