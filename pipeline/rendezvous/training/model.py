"""What training and evaluation ask of a model."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any, ClassVar, Generic

from torch import Tensor, nn

from rendezvous.training.batches import AnyBatch
from rendezvous.training.curve import CurvePoint, FrameErrorPoint
from rendezvous.training.frame_error.data import Batch


class TrainableModel(nn.Module, ABC, Generic[AnyBatch]):
    """A network with what it is trained on.

    Attributes:
        suitable_learning_rate: the highest with which it learns well in batches of about ten.
        point: what a validation of it finds.
    """

    suitable_learning_rate: ClassVar[float]
    point: ClassVar[type[CurvePoint]]

    @abstractmethod
    def config(self) -> dict[str, Any]:
        """All that its network is built from, as JSON holds it; weights are kept with it."""

    @abstractmethod
    def loss(self, batch: AnyBatch) -> tuple[Tensor, dict[str, float]]:
        """What is minimised, a scalar, and figures to watch."""


class FrameErrorModel(TrainableModel[Batch]):
    """A network that finds the frame error in a window, with what it is trained on."""

    point = FrameErrorPoint

    @abstractmethod
    def theta(self, cells_B2NN: Tensor, sight_B2NN: Tensor) -> Tensor:
        """(B, 3) float32 estimated frame error: x [m], y [m], yaw [rad].

        Args:
            cells_B2NN, sight_B2NN: as in `Batch`.
        """
