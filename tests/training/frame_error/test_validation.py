"""What validation reports of models whose error is known."""

from __future__ import annotations

import pytest
import torch
from rendezvous.training.frame_error.data import Batch, validation_batches
from rendezvous.training.frame_error.pairs import PairTable
from rendezvous.training.frame_error.validation import validate
from torch import Tensor

from tests.training.tiny import SAMPLING, TinyModel

CPU = torch.device("cpu")


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


@pytest.mark.parametrize("off", [(0.0, 0.0, 0.0), (0.3, 0.0, 0.0), (0.0, 0.0, -0.2), (0.0, 0.0, 6.1)])
def test_the_error_is_the_mean_of_the_absolute_components(pairs: PairTable, off):
    batches = validation_batches(pairs, SAMPLING, seed=0, count=6, batch_size=4)
    found = validate(Told(batches, off).eval(), batches, device=CPU, seed=0)
    expected = (off[0], off[1], abs((off[2] + 3.141592653589793) % 6.283185307179586 - 3.141592653589793))
    assert found.error == pytest.approx(expected, abs=1e-5)


def test_the_loss_is_the_mean_over_samples_not_batches(pairs: PairTable):
    model = TinyModel().eval()
    found = [
        validate(
            model,
            validation_batches(pairs, SAMPLING, seed=0, count=5, batch_size=size),
            device=CPU,
            seed=0,
        )
        for size in (5, 4)
    ]
    assert found[0].loss == pytest.approx(found[1].loss, rel=1e-5)
    assert found[0].error == pytest.approx(found[1].error, rel=1e-5)
