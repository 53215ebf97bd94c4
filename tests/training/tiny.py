"""A model that trains in a moment: what is left of the windows at 12 x 12 cells, and a perceptron."""

from __future__ import annotations

from contextlib import nullcontext
from typing import Any

import pytest
import torch
from torch import Tensor, nn
from torch.nn import functional

from rendezvous.training.frame_error.data import Batch
from rendezvous.training.frame_error.registry import FrameErrorModel
from rendezvous.training.loop import Step, TrainingState
from rendezvous.training.parameters import Sampling

SAMPLING = Sampling(window_cells=48, window_cell_m=0.4)


class TinyModel(FrameErrorModel):
    """Squared error; its loss draws from PyTorch's generator, as a dropout would."""

    suitable_learning_rate = 1e-2

    def __init__(self) -> None:
        super().__init__()
        self.layers = nn.Sequential(nn.Linear(288, 16), nn.LayerNorm(16), nn.GELU(), nn.Linear(16, 3))

    def config(self) -> dict[str, Any]:
        return {"hidden": 16}

    def loss(self, batch: Batch) -> tuple[Tensor, dict[str, float]]:
        difference = self.theta(batch["cells"], batch["sight"]) - batch["theta"]
        kept = (torch.rand(3) < 0.9).float() if self.training else torch.ones(3)
        loss = (kept * difference).square().mean()
        return loss, {"kept": float(kept.mean())}

    def theta(self, cells_B2NN: Tensor, sight_B2NN: Tensor) -> Tensor:
        return self.layers(functional.adaptive_avg_pool2d(cells_B2NN.float(), 12).flatten(1)).float()


def tiny_model(seed: int = 0) -> TinyModel:
    torch.manual_seed(seed)
    return TinyModel()


class Losses:
    """An observer that keeps the loss of each step, and is killed when it is told to be."""

    def __init__(self, *, killed_after: int | None = None) -> None:
        self.losses: list[float] = []
        self._killed_after = killed_after

    def after(self, state: TrainingState, step: Step) -> None:
        self.losses.append(step.loss)
        if len(self.losses) == self._killed_after:
            raise KeyboardInterrupt


def killed_by(error: type[BaseException], *, when: bool):
    """Expects a run to be killed, if it shall be."""
    return pytest.raises(error) if when else nullcontext()
