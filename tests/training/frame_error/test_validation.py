"""Validation figures of models with known errors."""

from __future__ import annotations

import math

import pytest
import torch
from torch import Tensor

from rendezvous.training.frame_error.data import Batch, validation_batches
from rendezvous.training.frame_error.pairs import PairTable
from rendezvous.training.frame_error.registry import FrameErrorValidation
from tests.training.tiny import SAMPLING, TinyModel, tiny_model


class Told(TinyModel):
    """Knows the answers, and is off by a motion of its own on the right: θ̂ = θ · off."""

    def __init__(self, batches: list[Batch], off: tuple[float, float, float]) -> None:
        super().__init__()
        self._answers = {batch["cells"].numpy().tobytes(): batch["theta"] for batch in batches}
        self._off = torch.tensor(off)

    def theta(self, cells_B2NN: Tensor, sight_B2NN: Tensor) -> Tensor:
        x, y, yaw = self._answers[cells_B2NN.numpy().tobytes()].unbind(1)
        off_x, off_y, off_yaw = self._off
        c, s = torch.cos(yaw), torch.sin(yaw)
        return torch.stack([x + c * off_x - s * off_y, y + s * off_x + c * off_y, yaw + off_yaw], dim=1)


def figures(model: TinyModel, batches: list[Batch]) -> dict[str, float | None]:
    return FrameErrorValidation(batches=batches, device=torch.device("cpu"), seed=0).figures(model.eval())


@pytest.mark.parametrize("off", [(0.0, 0.0, 0.0), (0.3, 0.0, 0.0), (0.0, 0.0, -0.2), (0.0, 0.0, 6.1)])
def test_the_error_is_the_mean_of_the_absolute_components(pairs: PairTable, off):
    batches = validation_batches(pairs, SAMPLING, seed=0, count=6, batch_size=4)
    found = figures(Told(batches, off), batches)
    expected = (off[0], off[1], abs((off[2] + math.pi) % math.tau - math.pi))
    assert [found[f"error_{name}"] for name in ("x_m", "y_m", "yaw_rad")] == pytest.approx(expected, abs=1e-5)


def test_the_loss_is_the_mean_over_samples_not_batches(pairs: PairTable):
    one, two = (
        figures(tiny_model(), validation_batches(pairs, SAMPLING, seed=0, count=5, batch_size=size))
        for size in (5, 4)
    )
    assert one.keys() == two.keys()
    assert list(one.values()) == pytest.approx(list(two.values()), rel=1e-5)
