"""The interface of a trainable model, and the points of its curve."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import asdict, dataclass
from typing import Any, ClassVar, Generic

from torch import Tensor, nn

from rendezvous.training.batches import AnyBatch


@dataclass(frozen=True, slots=True, kw_only=True)
class CurvePoint(ABC):
    """A point of the training curve; each kind of model adds its own errors.

    Attributes:
        samples: seen so far.
        elapsed_s: time in training, validation included.
        training_loss: mean since the last point.
        validation_loss: of the averaged weights.
    """

    samples: int
    elapsed_s: float
    training_loss: float
    validation_loss: float

    def as_dict(self) -> dict[str, float | None]:
        """Values by field; None where there is no value."""
        return asdict(self)

    @abstractmethod
    def summary(self) -> str:
        """One line for the terminal."""


class TrainableModel(nn.Module, ABC, Generic[AnyBatch]):
    """A network and its loss.

    Attributes:
        suitable_learning_rate: the highest at which it learns well in batches of about ten.
        point: the kind of its curve's points.
    """

    suitable_learning_rate: ClassVar[float]
    point: ClassVar[type[CurvePoint]]

    @abstractmethod
    def config(self) -> dict[str, Any]:
        """The network's config as JSON holds it; it is kept with the weights."""

    @abstractmethod
    def loss(self, batch: AnyBatch) -> tuple[Tensor, dict[str, float]]:
        """The loss, a scalar, and figures to watch."""
