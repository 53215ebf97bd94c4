"""Batches for training and validation, drawn from pairs.

A sample is a function of the seed and its number alone, so that any number of workers and processes, and a
run that was killed and goes on, see the same samples.

Legend: B sample, 2 map (0, then 1 as the wrong transform places it), N cells along a side of the window.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import TypedDict

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.utils.data import DataLoader, Dataset, Sampler

from pipeline.geometry.occupancy_grid import Cells
from pipeline.seeds import stream
from pipeline.training.augmentation import augmented
from pipeline.training.pairs import PairTable
from pipeline.training.parameters import Sampling
from pipeline.training.perturbation import (
    PerturbedPair,
    draw_perturbation,
    evaluation_perturbation,
    perturbed_pair,
)

_BATCHES_AHEAD = 4


class Batch(TypedDict):
    """Samples side by side.

    Attributes:
        cells: (B, 2, N, N) uint8 of `alignment.window`'s cells.
        sight: (B, 2, N, N) uint8 of `alignment.sight`'s cells; all hidden where no sighting is told.
        theta: (B, 3) float32 frame error in the window frame: x [m], y [m], yaw [rad].
    """

    cells: Tensor
    sight: Tensor
    theta: Tensor


class TrainingBatches(Dataset[Batch]):
    """Batches by their number; every epoch is a permutation of all pairs.

    Attributes:
        batch_size: samples of this process in a batch.
        rank, processes: this process among those that share each step.
    """

    def __init__(
        self,
        pairs: PairTable,
        sampling: Sampling,
        *,
        seed: int,
        batch_size: int,
        rank: int = 0,
        processes: int = 1,
    ) -> None:
        self.pairs, self.sampling, self.seed = pairs, sampling, seed
        self.batch_size, self.rank, self.processes = batch_size, rank, processes
        self._permutation: tuple[int, NDArray[np.int64]] | None = None

    def __getitem__(self, step: int) -> Batch:
        first = (step * self.processes + self.rank) * self.batch_size
        return _batch([self.sample(number) for number in range(first, first + self.batch_size)])

    def sample(self, number: int) -> PerturbedPair:
        """One sample by its number."""
        epoch, place = divmod(number, len(self.pairs))
        pair = self.pairs[int(self._order(epoch)[place])]
        rng, sampling = stream(self.seed, "train", number), self.sampling
        perturbation = draw_perturbation(sampling.perturbation, rng)
        sample = perturbed_pair(
            augmented(pair, sampling.augmentation, rng),
            perturbation,
            cells=sampling.window_cells,
            cell_m=sampling.window_cell_m,
        )
        if rng.random() < sampling.sight_withheld:
            sample = replace(sample, window=sample.window.of_maps_alone())
        return sample

    def _order(self, epoch: int) -> NDArray[np.int64]:
        if self._permutation is None or self._permutation[0] != epoch:
            order = stream(self.seed, "train", "epoch", epoch).permutation(len(self.pairs))
            self._permutation = (epoch, order)
        return self._permutation[1]


def training_loader(
    batches: TrainingBatches, *, first_step: int, workers: int, pin_memory: bool
) -> DataLoader[Batch]:
    """Endless batches in order.

    Args:
        batches: what to load.
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


def validation_batches(
    pairs: PairTable, sampling: Sampling, *, seed: int, count: int, batch_size: int
) -> list[Batch]:
    """Pairs as they are, spread evenly over the split, each under its fixed perturbation.

    Args:
        pairs: the split.
        sampling: the range and the window.
        seed: of the perturbations.
        count: at most so many pairs.
        batch_size: samples in a batch.
    """
    count = min(count, len(pairs))
    chosen = [pairs[int(place)] for place in np.linspace(0, len(pairs) - 1, count).round()]
    samples = [
        perturbed_pair(
            pair,
            evaluation_perturbation(pair.pair_id, sampling.perturbation, seed=seed),
            cells=sampling.window_cells,
            cell_m=sampling.window_cell_m,
        )
        for pair in chosen
    ]
    return [_batch(samples[i : i + batch_size]) for i in range(0, count, batch_size)]


def moved(batch: Batch, device: torch.device) -> Batch:
    """The batch on a device."""
    return Batch(
        cells=batch["cells"].to(device, non_blocking=True),
        sight=batch["sight"].to(device, non_blocking=True),
        theta=batch["theta"].to(device, non_blocking=True),
    )


class _StepsFrom(Sampler[int]):
    def __init__(self, first_step: int) -> None:
        self._first_step = first_step

    def __iter__(self) -> Iterator[int]:
        step = self._first_step
        while True:
            yield step
            step += 1


def _batch(samples: list[PerturbedPair]) -> Batch:
    windows = [sample.window for sample in samples]
    cells: Cells = np.stack([window.cells for window in windows])
    sight = [np.zeros_like(w.cells) if w.sight is None else w.sight for w in windows]
    theta = np.array([sample.theta_w.as_array() for sample in samples], np.float32)
    return Batch(
        cells=torch.from_numpy(cells),
        sight=torch.from_numpy(np.stack(sight)),
        theta=torch.from_numpy(theta),
    )


def _init_worker(_worker: int) -> None:
    cv2.setNumThreads(0)  # a worker has one core
