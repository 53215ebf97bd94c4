"""Batches for training and validation, drawn from pairs.

A sample is a function of the seed and its number alone, so that any number of workers and processes, and a
run that was killed and goes on, see the same samples.

Legend: B sample, 2 map (0, then 1 as the wrong transform places it), N cells along a side of the window.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TypedDict

import numpy as np
import torch
from torch import Tensor
from torch.utils.data import Dataset

from rendezvous.geometry.occupancy_grid import Cells
from rendezvous.seeds import stream
from rendezvous.training.batches import EpochOrder
from rendezvous.training.frame_error.augmentation import augmented
from rendezvous.training.frame_error.pairs import PairTable
from rendezvous.training.frame_error.perturbation import (
    PerturbedPair,
    draw_perturbation,
    evaluation_perturbation,
    perturbed_pair,
)
from rendezvous.training.parameters import Sampling


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
        self._order = EpochOrder(len(pairs), seed=seed)

    def __getitem__(self, step: int) -> Batch:
        first = (step * self.processes + self.rank) * self.batch_size
        return _batch([self.sample(number) for number in range(first, first + self.batch_size)])

    def sample(self, number: int) -> PerturbedPair:
        """One sample by its number."""
        pair = self.pairs[self._order.row(number)]
        rng, sampling = stream(self.seed, "train", number), self.sampling
        perturbation = draw_perturbation(sampling.perturbation, rng)
        sample = perturbed_pair(
            augmented(pair, sampling.augmentation, rng),
            perturbation,
            cells=sampling.window_cells,
            cell_m=sampling.window_cell_m,
        )
        if rng.random() < sampling.sight_withheld:
            sample = replace(sample, window=sample.window.without_sight())
        return sample


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


def _batch(samples: list[PerturbedPair]) -> Batch:
    windows = [sample.window for sample in samples]
    cells: Cells = np.stack([window.cells for window in windows])
    sight = [np.zeros_like(w.cells) if w.sight is None else w.sight for w in windows]
    theta = np.array([sample.theta_v.as_array() for sample in samples], np.float32)
    return Batch(
        cells=torch.from_numpy(cells),
        sight=torch.from_numpy(np.stack(sight)),
        theta=torch.from_numpy(theta),
    )
