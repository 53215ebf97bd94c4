"""Weights that step, and their moving average."""

from __future__ import annotations

import copy
import math
from typing import TypeVar

import torch
from torch import nn

from rendezvous.training.parameters import Optimisation

Module = TypeVar("Module", bound=nn.Module)


def adamw(model: nn.Module, settings: Optimisation) -> torch.optim.AdamW:
    """AdamW that lets decay only weights of two axes or more: no biases, gains of norms, or scales.

    Its rate is set at each step.
    """
    parameters = [p for p in model.parameters() if p.requires_grad]
    groups = [
        {"params": [p for p in parameters if p.ndim >= 2], "weight_decay": settings.weight_decay},
        {"params": [p for p in parameters if p.ndim < 2], "weight_decay": 0.0},
    ]
    return torch.optim.AdamW([group for group in groups if group["params"]], betas=(0.9, 0.98))


def learning_rate(spent: float, settings: Optimisation, *, highest: float) -> float:
    """The rate once a share of the budget is spent: up a straight line, down half a cosine."""
    warmup = settings.warmup_share
    if spent < warmup:
        # Time may not have moved yet at the first step, which shall move the weights nevertheless.
        return highest * max(spent / warmup, 1e-3)
    share = (spent - warmup) / (1.0 - warmup)
    final = settings.final_share
    return highest * (final + (1.0 - final) * 0.5 * (1.0 + math.cos(math.pi * min(share, 1.0))))


def set_learning_rate(optimizer: torch.optim.Optimizer, rate: float) -> None:
    """Set the rate of all groups."""
    for group in optimizer.param_groups:
        group["lr"] = rate


def averaged_copy(model: Module) -> Module:
    """The model that the moving average starts from: the same weights, of which no gradient is asked."""
    return copy.deepcopy(model).requires_grad_(False).eval()


@torch.no_grad()
def update_average(average: nn.Module, model: nn.Module, *, step: int, decay: float) -> None:
    """Move the average towards the model; early on faster, so that the first weights are forgotten.

    Args:
        average: changed in place.
        model: after step number `step`, the first being 1.
        step: how many steps were taken.
        decay: what is kept of the average at a late step.
    """
    kept = min(decay, step / (10.0 + step))
    torch._foreach_lerp_(list(average.parameters()), list(model.parameters()), 1.0 - kept)
    for mine, theirs in zip(average.buffers(), model.buffers(), strict=True):
        mine.copy_(theirs)
