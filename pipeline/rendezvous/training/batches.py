"""Batches by their number, for any model: who loads them, and in which order rows come.

A batch is a mapping of tensors, the samples along the first axis of each.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, TypeVar, cast

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch.utils.data import DataLoader, Dataset, Sampler

from rendezvous.seeds import stream

AnyBatch = TypeVar("AnyBatch", bound=Mapping[str, Any])

_BATCHES_AHEAD = 4


class EpochOrder:
    """Every epoch is a permutation of all rows."""

    def __init__(self, rows: int, *, seed: int) -> None:
        self._rows, self._seed = rows, seed
        self._permutation: tuple[int, NDArray[np.int64]] | None = None

    def row(self, number: int) -> int:
        """The row that a sample is drawn from, by the sample's number."""
        epoch, place = divmod(number, self._rows)
        if self._permutation is None or self._permutation[0] != epoch:
            order = stream(self._seed, "train", "epoch", epoch).permutation(self._rows)
            self._permutation = (epoch, order)
        return int(self._permutation[1][place])


def training_loader(
    batches: Dataset[AnyBatch], *, first_step: int, workers: int, pin_memory: bool
) -> DataLoader[AnyBatch]:
    """Endless batches in order.

    Args:
        batches: what to load, by the number of the step.
        first_step: number of the first batch.
        workers: processes that draw samples beside the one that trains; 0: it draws them itself.
        pin_memory: for copies to a GPU.
    """
    return DataLoader(
        batches,
        batch_size=None,
        sampler=_StepsFrom(first_step),
        num_workers=workers,
        prefetch_factor=_BATCHES_AHEAD if workers else None,
        worker_init_fn=_init_worker,
        pin_memory=pin_memory,
    )


def moved(batch: AnyBatch, device: torch.device) -> AnyBatch:
    """The batch on a device."""
    there = {name: tensor.to(device, non_blocking=True) for name, tensor in batch.items()}
    return cast(AnyBatch, there)


def samples_in(batch: Mapping[str, Any]) -> int:
    """How many samples lie side by side."""
    return len(next(iter(batch.values())))


class _StepsFrom(Sampler[int]):
    def __init__(self, first_step: int) -> None:
        self._first_step = first_step

    def __iter__(self) -> Iterator[int]:
        step = self._first_step
        while True:
            yield step
            step += 1


def _init_worker(_worker: int) -> None:
    cv2.setNumThreads(0)  # a worker has one core
