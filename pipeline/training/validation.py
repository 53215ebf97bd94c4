"""How far a model's estimates are off, with the weights that would be published."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass

import numpy as np
import torch

from pipeline.alignment.frame_error import pose_difference
from pipeline.geometry.se2 import SE2
from pipeline.training.data import Batch, moved
from pipeline.training.model import FrameErrorModel


@dataclass(frozen=True, slots=True, kw_only=True)
class CurvePoint:
    """Where training stood once: one point of "error against training samples".

    Attributes:
        samples: seen so far.
        elapsed_s: time in training, validation included.
        training_loss: mean since the last point.
        validation_loss: of the averaged weights.
        error_x_m, error_y_m, error_yaw_rad: mean absolute components of θ̂⁻¹ θ on the validation pairs.
    """

    samples: int
    elapsed_s: float
    training_loss: float
    validation_loss: float
    error_x_m: float
    error_y_m: float
    error_yaw_rad: float

    def as_dict(self) -> dict[str, float]:
        """Values by field."""
        return asdict(self)

    def told(self) -> str:
        """In words."""
        return (
            f"{self.samples} samples: loss {self.training_loss:.4g}, on validation pairs "
            f"{self.validation_loss:.4g}, mean error {self.error_x_m:.3f} m, {self.error_y_m:.3f} m, "
            f"{self.error_yaw_rad:.3f} rad"
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class ValidationResult:
    """Mean loss and mean absolute x [m], y [m], yaw [rad] of θ̂⁻¹ θ."""

    loss: float
    error: tuple[float, float, float]


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
