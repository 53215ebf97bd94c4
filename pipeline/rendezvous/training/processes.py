"""One training run in one process or several: the values they share at each step."""

from __future__ import annotations

from dataclasses import dataclass, field

import torch
from torch import distributed as dist
from torch import nn
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
        return self.rank == 0

    def synchronised(self, module: nn.Module) -> nn.Module:
        """The module, with gradients averaged over all processes."""
        return DistributedDataParallel(module) if self.count > 1 else module

    def mean(self, value: float) -> float:
        """Mean over all processes, known to all."""
        if self.count == 1:
            return value
        shared = torch.tensor([value], dtype=torch.float64, device=self.device)
        dist.all_reduce(shared)
        return float(shared) / self.count

    def agreed(self, value: float) -> float:
        """The first process's value: what depends on a clock must be the same for all."""
        if self.count == 1:
            return value
        shared = torch.tensor([value], dtype=torch.float64, device=self.device)
        dist.broadcast(shared, 0)
        return float(shared)
