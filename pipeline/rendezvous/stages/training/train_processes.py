"""Join the processes that torchrun has started, and take a device."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager

import torch
from torch import distributed as dist

from rendezvous.training.processes import Processes


@contextmanager
def joined_processes() -> Iterator[Processes]:
    """This process among those of one training run; alone unless torchrun started it."""
    local_rank = int(os.environ.get("LOCAL_RANK", "0"))
    device = torch.device("cuda", local_rank) if torch.cuda.is_available() else torch.device("cpu")
    if device.type == "cuda":
        torch.cuda.set_device(device)
    if "WORLD_SIZE" not in os.environ:
        yield Processes(device=device)
        return
    dist.init_process_group("nccl" if device.type == "cuda" else "gloo")
    try:
        yield Processes(
            rank=dist.get_rank(),
            count=dist.get_world_size(),
            on_this_machine=int(os.environ["LOCAL_WORLD_SIZE"]),
            device=device,
        )
    finally:
        dist.destroy_process_group()
