"""How far a model's estimates are off, with the weights that would be published."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch

from rendezvous.alignment.frame_error import pose_difference
from rendezvous.geometry.camera import Image
from rendezvous.geometry.se2 import SE2
from rendezvous.training.batches import moved
from rendezvous.training.frame_error.data import Batch
from rendezvous.training.model import FrameErrorModel


@dataclass(frozen=True, slots=True, kw_only=True)
class ValidationResult:
    """Mean loss and mean absolute x [m], y [m], yaw [rad] of θ̂⁻¹ θ."""

    loss: float
    error: tuple[float, float, float]


@dataclass(frozen=True, slots=True, kw_only=True)
class FrameErrorValidation:
    """Measures models on pairs that stay the same.

    Attributes:
        batches: of the pairs.
        device: where the models are.
        seed: of what the loss itself may draw.
    """

    batches: Sequence[Batch]
    device: torch.device
    seed: int

    def figures(self, model: FrameErrorModel) -> dict[str, float | None]:
        """What a `FrameErrorPoint` tells of them."""
        found = validate(model, self.batches, device=self.device, seed=self.seed)
        return {
            "validation_loss": found.loss,
            "error_x_m": found.error[0],
            "error_y_m": found.error[1],
            "error_yaw_rad": found.error[2],
        }

    def pictures(self, model: FrameErrorModel) -> dict[str, Image]:
        """None."""
        return {}


@torch.no_grad()
def validate(
    model: FrameErrorModel, batches: Sequence[Batch], *, device: torch.device, seed: int
) -> ValidationResult:
    """Loss and error of a model over batches, in float32.

    Args:
        model: in evaluation mode.
        batches: fixed pairs.
        device: where the model is.
        seed: of what the loss itself may draw from PyTorch's generator.
    """
    losses, errors = [], []
    for number, batch in enumerate(batches):
        torch.manual_seed(seed + number)
        there = moved(batch, device)
        losses.append(float(model.loss(there)[0]) * len(batch["theta"]))
        theta_hat_B3 = model.theta(there["cells"], there["sight"]).cpu()
        for estimated, true in zip(theta_hat_B3.tolist(), batch["theta"].tolist(), strict=True):
            errors.append(pose_difference(SE2(*estimated), SE2(*true)).as_array())
    mean = np.abs(np.array(errors)).mean(axis=0)
    return ValidationResult(
        loss=sum(losses) / len(errors), error=(float(mean[0]), float(mean[1]), float(mean[2]))
    )
