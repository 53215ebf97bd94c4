"""Batches by their number for any model: the order of their rows, and their loader.

A batch is a mapping of tensors, the samples along the first axis of each.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from itertools import count
from typing import Any, Generic, TypeVar, cast

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch.utils.data import DataLoader, Dataset

from rendezvous.seeds import stream

AnyBatch = TypeVar("AnyBatch", bound=Mapping[str, Any])
AnySample = TypeVar("AnySample")

_BATCHES_AHEAD = 4


class EpochOrder:
    """Rows in an order in which every epoch is a permutation of all rows."""

    def __init__(self, rows: int, *, seed: int) -> None:
        self._rows, self._seed = rows, seed
        self._permutation: tuple[int, NDArray[np.int64]] | None = None

    def row(self, number: int) -> int:
        """The row for a sample's number."""
        epoch, place = divmod(number, self._rows)
        if self._permutation is None or self._permutation[0] != epoch:
            order = stream(self._seed, "train", "epoch", epoch).permutation(self._rows)
            self._permutation = (epoch, order)
        return int(self._permutation[1][place])


class NumberedBatches(Dataset[AnyBatch], ABC, Generic[AnySample, AnyBatch]):
    """Batches by the number of the step. A sample is a function of the seed and its own number alone.

    Any number of workers and processes, and a run that was killed and resumes, see the same samples.

    `rank` is the number of this process among the `processes` that share each step.
    """

    def __init__(self, *, seed: int, batch_size: int, rank: int = 0, processes: int = 1) -> None:
        self.seed, self.batch_size, self.rank, self.processes = seed, batch_size, rank, processes

    def __getitem__(self, step: int) -> AnyBatch:
        first = (step * self.processes + self.rank) * self.batch_size
        return self.batch([self.sample(number) for number in range(first, first + self.batch_size)])

    @abstractmethod
    def sample(self, number: int) -> AnySample:
        """One sample by its number."""

    @abstractmethod
    def batch(self, samples: list[AnySample]) -> AnyBatch:
        """Samples side by side."""


def evenly_spread(rows: Sequence[int], count: int) -> list[int]:
    """At most `count` of the rows, evenly spread."""
    places = np.linspace(0, len(rows) - 1, min(count, len(rows))).round()
    return [rows[int(place)] for place in places]


def training_loader(
    batches: Dataset[AnyBatch], *, first_step: int, workers: int, pin_memory: bool
) -> DataLoader[AnyBatch]:
    """Endless batches in order."""
    return DataLoader(
        batches,
        batch_size=None,
        sampler=count(first_step),
        num_workers=workers,
        prefetch_factor=_BATCHES_AHEAD if workers else None,
        worker_init_fn=_init_worker,
        pin_memory=pin_memory,
    )


def moved(batch: AnyBatch, device: torch.device) -> AnyBatch:
    """The batch on a device."""
    there = {name: tensor.to(device, non_blocking=True) for name, tensor in batch.items()}
    return cast(AnyBatch, there)


def _init_worker(_worker: int) -> None:
    cv2.setNumThreads(0)  # a worker has one core
