"""All models that can be trained, behind one interface."""

from __future__ import annotations

import json
import math
from typing import Any

import pytest
import torch

from rendezvous.errors import ConfigError
from rendezvous.training.frame_error.data import TrainingBatches
from rendezvous.training.frame_error.pairs import PairTable, PerturbationRange
from rendezvous.training.frame_error.registry import (
    MODEL_NAMES,
    FrameErrorModel,
    MatcherModel,
    build_model,
    rebuilt_model,
)
from rendezvous.training.parameters import Sampling

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


@pytest.mark.parametrize(
    ("name", "settings", "said"),
    [
        ("cnn", {"cells": "many"}, "cells of cnn is 'many'; must be like 192"),
        ("cnn", {"zzz": 0}, "cnn has no 'zzz'; known are cells, width, depth, heads"),
        ("cnn", {"cells": 0}, "cells is 0; must be 12 times 2"),
        ("cnn", {"cells": 96}, "cells is 96; must divide the window's 48 cells"),
        ("cnn", {"heads": 0}, "heads is 0; must be from 1 to 1024"),
        ("cnn", {"vit": True}, "vit is True; must be left out, as it follows from train.model"),
        ("vit-lie", {"lie": False}, "lie is False; must be left out"),
        ("vit-lie", {"cell_m": 0.1}, "cell_m is 0.1; must be left out"),
        ("matcher", {"cell_m": 0.1}, "cell_m is 0.1; must be left out"),
        ("matcher", {"coarse_factor": 32}, "coarse_factor is 32; must divide the window's 48 cells"),
        ("matcher", {"coarse_factor": 0}, "coarse_factor is 0; must be from 1 to 64"),
        ("matcher", {"fine_factor": 0}, "fine_factor is 0; must be from 1 to 64"),
        ("matcher", {"heading_step_rad": 0}, "heading_step_rad is 0; must be from 0.00174533 to 1.0472"),
        ("matcher", {"heading_step_rad": math.nan}, "heading_step_rad is nan; must be from"),
        ("matcher", {"channels": 0}, "channels is 0; must be from 1 to 4096"),
        ("matcher", {"coarse_features": 0}, "coarse_features is 0; must be from 1 to 4096"),
        ("matcher", {"fine_channels": 0}, "fine_channels is 0; must be from 1 to 4096"),
        ("matcher", {"fine_features": 0}, "fine_features is 0; must be from 1 to 4096"),
        ("matcher", {"reach_cells": -1}, "reach_cells is -1; must be from 0 to 4096"),
        ("matcher", {"dilations": [1, 0]}, "dilations is [1, 0]; each must be from 1 to 256"),
        ("matcher", {"dilations": ["a"]}, "dilations of matcher is ['a']; must be like (1, 2,"),
    ],
)
def test_settings_without_use_are_told(name: str, settings: dict[str, Any], said: str):
    with pytest.raises(ConfigError) as caught:
        build_model(name, settings, Sampling(window_cells=48, window_cell_m=0.4), seed=0)
    assert str(caught.value).startswith("train.settings: ")
    assert said in str(caught.value)


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
