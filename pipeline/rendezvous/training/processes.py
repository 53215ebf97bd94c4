"""One training run in one process or several: the values they share at each step."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial

import torch
from torch import Tensor, nn
from torch import distributed as dist
from torch.nn.parallel import DistributedDataParallel


@dataclass(frozen=True, slots=True, kw_only=True)
class Processes:
    """This process among those that train together.

    Attributes:
        rank: its number; the first validates, saves and reports.
        count: number of processes; with more than one the group of `torch.distributed` has been joined.
        on_this_machine: number of them that share this machine's cores.
        device: on which it computes its share of a batch.
    """

    rank: int = 0
    count: int = 1
    on_this_machine: int = 1
    device: torch.device = field(default_factory=lambda: torch.device("cpu"))

    @property
    def first(self) -> bool:
        """Whether this process is the first."""
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
