"""All models that can be trained, behind one interface."""

from __future__ import annotations

import json
import math

import pytest
import torch

from pipeline.errors import ConfigError
from pipeline.training.data import TrainingBatches
from pipeline.training.model import FrameErrorModel
from pipeline.training.pairs import PairTable
from pipeline.training.parameters import Sampling
from pipeline.training.perturbation import PerturbationRange
from pipeline.training.registry import MODEL_NAMES, MatcherModel, build_model, rebuilt_model

SAMPLING = Sampling(window_cells=96, window_cell_m=0.1, perturbation=PerturbationRange(xy_m=0.5, yaw_rad=0.2))
SMALL = {name: {"cells": 48, "width": 16, "depth": 1, "heads": 2} for name in MODEL_NAMES} | {
    "matcher": {"channels": 8, "dilations": [1, 2]}
}


def small(name: str, *, seed: int = 0) -> FrameErrorModel:
    return build_model(name, SMALL[name], SAMPLING, seed=seed)


@pytest.mark.parametrize("name", MODEL_NAMES)
def test_a_model_gives_a_loss_with_gradients_and_an_estimate(name: str, pairs: PairTable):
    batch = TrainingBatches(pairs, SAMPLING, seed=0, batch_size=2)[0]
    model = small(name)
    loss, figures = model.loss(batch)
    loss.backward()
    assert loss.shape == ()
    assert all(math.isfinite(value) for value in figures.values())
    assert sum(float(p.grad.abs().sum()) for p in model.parameters() if p.grad is not None) > 0.0
    with torch.no_grad():
        theta = model.eval().theta(batch["cells"], batch["sight"])
    assert theta.shape == (2, 3)
    assert theta.dtype == torch.float32
    assert torch.isfinite(theta).all()


@pytest.mark.parametrize("name", MODEL_NAMES)
def test_a_model_is_rebuilt_from_its_configuration_alone(name: str):
    model = small(name)
    config = json.loads(json.dumps(model.config()))
    again = rebuilt_model(name, config, SAMPLING)
    again.load_state_dict(model.state_dict())
    assert again.config() == model.config()
    with pytest.raises(ConfigError):
        rebuilt_model(name, {k: v for k, v in config.items() if k != "cell_m"}, SAMPLING)


@pytest.mark.parametrize("name", ["matcher", "vit", "cnn"])
def test_equal_seeds_give_equal_first_weights(name: str):
    one, same, other = (
        torch.cat([p.flatten() for p in small(name, seed=seed).parameters()]) for seed in (0, 0, 1)
    )
    assert torch.equal(one, same)
    assert not torch.equal(one, other)


def test_a_network_of_the_paper_sees_the_whole_window():
    model = small("vit-reg-lie")
    assert model.network.config.cells * model.network.config.cell_m == pytest.approx(9.6)
    assert model.network.config.lie
    assert not small("vit-reg").network.config.lie


def test_the_matcher_searches_as_far_as_its_samples_are_off():
    model = small("matcher")
    assert isinstance(model, MatcherModel)
    assert model.search.xy_m == pytest.approx(0.5 * math.sqrt(2.0))
    wide = Sampling(perturbation=PerturbationRange(wide_share=0.5, wide_xy_m=4.0))
    assert build_model("matcher", {}, wide, seed=0).search.yaw_rad == math.pi
