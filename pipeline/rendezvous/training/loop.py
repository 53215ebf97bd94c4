"""The training loop: AdamW, a learning rate that follows the budget, and a moving average of the weights."""

from __future__ import annotations

import copy
import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from typing import Any, ClassVar, Generic, Protocol, TypeVar

import torch
from torch import Tensor, nn
from torch import distributed as dist
from torch.nn.parallel import DistributedDataParallel

from rendezvous.errors import ConfigError
from rendezvous.models.precision import computes_in_bf16
from rendezvous.seeds import stream
from rendezvous.training.batches import AnyBatch, moved
from rendezvous.training.parameters import Budget, Optimisation


@dataclass(frozen=True, slots=True, kw_only=True)
class CurvePoint(ABC):
    """A point of the training curve; each kind of model adds its own errors."""

    samples: int
    elapsed_s: float  # validation included
    training_loss: float  # mean since the last point
    validation_loss: float

    def as_dict(self) -> dict[str, float | None]:
        """Values by field; None where there is no value."""
        return asdict(self)

    @abstractmethod
    def summary(self) -> str:
        """One line for the terminal."""


class TrainableModel(nn.Module, ABC, Generic[AnyBatch]):
    """A network and its loss."""

    suitable_learning_rate: ClassVar[float]  # the highest at which it learns well in batches of about ten
    point: ClassVar[type[CurvePoint]]

    @abstractmethod
    def config(self) -> dict[str, Any]:
        """The network's config as JSON holds it; it is kept with the weights."""

    @abstractmethod
    def loss(self, batch: AnyBatch) -> tuple[Tensor, dict[str, float]]:
        """The loss, a scalar, and figures to watch."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Processes:
    """This process among those that train together."""

    rank: int = 0  # 0 for the first, which validates, saves and reports
    count: int = 1  # above 1, the group of `torch.distributed` has been joined
    on_this_machine: int = 1  # how many of them share this machine's cores
    device: torch.device = field(default_factory=lambda: torch.device("cpu"))

    @property
    def first(self) -> bool:
        return self.rank == 0

    def synchronised(self, module: nn.Module) -> nn.Module:
        """The module, with gradients averaged over all processes."""
        return DistributedDataParallel(module) if self.count > 1 else module

    def mean(self, value: float) -> float:
        """Mean over all processes, known to all."""
        return self._shared(value, dist.all_reduce) / self.count

    def agreed(self, value: float) -> float:
        """The first process's value: what depends on a clock must be the same for all."""
        return self._shared(value, partial(dist.broadcast, src=0))

    def _shared(self, value: float, exchange: Callable[[Tensor], object]) -> float:
        if self.count == 1:
            return value
        tensor = torch.tensor([value], dtype=torch.float64, device=self.device)
        exchange(tensor)
        return float(tensor)


Model = TypeVar("Model", bound=TrainableModel[Any])


@dataclass(slots=True, kw_only=True)
class TrainingState(Generic[Model]):
    """Everything that changes during training, and that a run needs to resume; over all processes."""

    model: Model
    average: Model
    optimizer: torch.optim.AdamW
    step: int = 0
    samples: int = 0
    elapsed_s: float = 0.0
    loss_sum: float = 0.0  # since the last point of the curve, as `loss_steps`
    loss_steps: int = 0
    curve: list[CurvePoint] = field(default_factory=list)

    @staticmethod
    def fresh(model: Model, optimisation: Optimisation) -> TrainingState[Model]:
        """The state before the first step; the average starts from the same weights and needs no gradient."""
        average = copy.deepcopy(model).requires_grad_(False).eval()
        return TrainingState(model=model, average=average, optimizer=adamw(model, optimisation))


@dataclass(frozen=True, slots=True, kw_only=True)
class Step:
    """Result of one step."""

    loss: float  # mean over all processes
    figures: dict[str, float]
    gradient_norm: float  # before clipping
    learning_rate: float
    spent: float  # share of the budget that was spent before


class Observer(Protocol[Model]):
    """Validates, saves and reports."""

    def after(self, state: TrainingState[Model], step: Step) -> None:
        """Called after each step, in every process."""


def fit(
    state: TrainingState[Model],
    batches: Iterable[AnyBatch],
    optimisation: Optimisation,
    budget: Budget,
    *,
    seed: int,
    processes: Processes,
    observer: Observer[Model],
    clock: Callable[[], float],
) -> None:
    """Train until the budget is spent.

    `state` is changed in place; `batches` begin with number `state.step`; `clock` gives seconds from any
    origin.

    Raises:
        ConfigError: the loss is not finite.
    """
    model = processes.synchronised(_Loss(state.model)).train()
    highest = optimisation.learning_rate or state.model.suitable_learning_rate
    device_type, began_s = processes.device.type, clock() - state.elapsed_s
    for batch in batches:
        spent = processes.agreed(budget.spent(state.samples, clock() - began_s))
        if spent >= 1.0:
            break
        rate = learning_rate(spent, optimisation, highest=highest)
        for group in state.optimizer.param_groups:
            group["lr"] = rate
        torch.manual_seed(int(stream(seed, "step", state.step, processes.rank).integers(2**62)))
        with torch.autocast(device_type, dtype=torch.bfloat16, enabled=optimisation.precision == "bf16"):
            loss, figures = model(moved(batch, processes.device))
        state.optimizer.zero_grad(set_to_none=True)
        loss.backward()
        norm = nn.utils.clip_grad_norm_(state.model.parameters(), optimisation.clip_norm)
        shown = processes.mean(float(loss.detach()))
        _check_finite(shown, float(norm), state.step)
        state.optimizer.step()
        state.step += 1
        state.samples += len(next(iter(batch.values()))) * processes.count
        state.loss_sum, state.loss_steps = state.loss_sum + shown, state.loss_steps + 1
        update_average(state.average, state.model, step=state.step, decay=optimisation.ema_decay)
        state.elapsed_s = clock() - began_s
        observer.after(
            state,
            Step(loss=shown, figures=figures, gradient_norm=float(norm), learning_rate=rate, spent=spent),
        )


class _Loss(nn.Module):
    """The loss as a forward pass, because `DistributedDataParallel` watches those."""

    def __init__(self, model: TrainableModel[Any]) -> None:
        super().__init__()
        self.model = model

    def forward(self, batch: Mapping[str, Any]) -> tuple[Tensor, dict[str, float]]:
        return self.model.loss(batch)


def _check_finite(loss: float, norm: float, step: int) -> None:
    if not (abs(loss) < float("inf") and norm < float("inf")):
        raise ConfigError(
            f"step {step}: the loss is {loss}, the gradient's norm {norm}; must be finite: "
            "a lower optimisation.learning_rate or precision fp32 may help"
        )


def adamw(model: nn.Module, optimisation: Optimisation) -> torch.optim.AdamW:
    """AdamW that decays only weights of two axes or more: no biases, gains of norms, or scales.

    Its learning rate is set at each step.
    """
    parameters = [p for p in model.parameters() if p.requires_grad]
    groups = [
        {"params": [p for p in parameters if p.ndim >= 2], "weight_decay": optimisation.weight_decay},
        {"params": [p for p in parameters if p.ndim < 2], "weight_decay": 0.0},
    ]
    return torch.optim.AdamW([group for group in groups if group["params"]], betas=(0.9, 0.98))


def with_precision(optimisation: Optimisation, device: torch.device) -> Optimisation:
    """The same with its precision settled: bfloat16 where the device computes in it."""
    if optimisation.precision is not None:
        return optimisation
    return replace(optimisation, precision="bf16" if computes_in_bf16(device) else "fp32")


def learning_rate(spent: float, optimisation: Optimisation, *, highest: float) -> float:
    """The rate once a share of the budget is spent: rises along a line, falls along half a cosine."""
    warmup = optimisation.warmup_share
    if spent < warmup:
        # Time may not have moved yet at the first step, which must move the weights nevertheless.
        return highest * max(spent / warmup, 1e-3)
    share = (spent - warmup) / (1.0 - warmup)
    final = optimisation.final_share
    return highest * (final + (1.0 - final) * 0.5 * (1.0 + math.cos(math.pi * min(share, 1.0))))


@torch.no_grad()
def update_average(average: nn.Module, model: nn.Module, *, step: int, decay: float) -> None:
    """Move the average towards the model; faster early on, so that the first weights are forgotten."""
    kept = min(decay, step / (10.0 + step))
    torch._foreach_lerp_(list(average.parameters()), list(model.parameters()), 1.0 - kept)
    for mine, theirs in zip(average.buffers(), model.buffers(), strict=True):
        mine.copy_(theirs)
