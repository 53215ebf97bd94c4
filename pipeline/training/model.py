"""What training and evaluation ask of a model."""

from __future__ import annotations

from abc import ABC, abstractmethod

from torch import Tensor, nn

from pipeline.training.data import Batch


class FrameErrorModel(nn.Module, ABC):
    """A network that finds the frame error in a window, with what it is trained on."""

    @abstractmethod
    def loss(self, batch: Batch) -> tuple[Tensor, dict[str, float]]:
        """What is minimised, a scalar, and figures to watch."""

    @abstractmethod
    def theta(self, cells_B2NN: Tensor) -> Tensor:
        """(B, 3) float32 estimated frame error: x [m], y [m], yaw [rad]."""
