"""The errors of a model's estimates on the validation pairs."""

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
from rendezvous.training.frame_error.registry import FrameErrorModel


@dataclass(frozen=True, slots=True, kw_only=True)
class FrameErrorValidation:
    """Measures models on fixed pairs."""

    batches: Sequence[Batch]
    device: torch.device
    seed: int

    @torch.no_grad()
    def figures(self, model: FrameErrorModel) -> dict[str, float | None]:
        """The errors of a `FrameErrorPoint`, in float32, of a model in evaluation mode."""
        losses, errors = [], []
        for number, batch in enumerate(self.batches):
            torch.manual_seed(self.seed + number)
            there = moved(batch, self.device)
            losses.append(float(model.loss(there)[0]) * len(batch["theta"]))
            theta_hat_B3 = model.theta(there["cells"], there["sight"]).cpu()
            for estimated, true in zip(theta_hat_B3.tolist(), batch["theta"].tolist(), strict=True):
                errors.append(pose_difference(SE2(*estimated), SE2(*true)).as_array())
        x_m, y_m, yaw_rad = np.abs(np.array(errors)).mean(axis=0).tolist()
        loss = sum(losses) / len(errors)
        return {"validation_loss": loss, "error_x_m": x_m, "error_y_m": y_m, "error_yaw_rad": yaw_rad}

    def pictures(self, model: FrameErrorModel) -> dict[str, Image]:
        """No pictures."""
        return {}
