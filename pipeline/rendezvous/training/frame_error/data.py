"""Batches for training and validation, drawn from pairs.

Legend: B sample, 2 map (0, then 1 as the wrong transform places it), N cells along a side of the window.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TypedDict

import numpy as np
import torch
from torch import Tensor

from rendezvous.geometry.occupancy_grid import Cells
from rendezvous.seeds import stream
from rendezvous.training.batches import EpochOrder, NumberedBatches, evenly_spread
from rendezvous.training.frame_error.augmentation import augmented
from rendezvous.training.frame_error.pairs import (
    PairTable,
    PerturbedPair,
    draw_perturbation,
    evaluation_perturbation,
    perturbed_pair,
)
from rendezvous.training.parameters import Sampling


class Batch(TypedDict):
    """Samples side by side."""

    cells: Tensor  # (B, 2, N, N) uint8 of `alignment.window`'s cells
    sight: Tensor  # (B, 2, N, N) uint8 of `alignment.window`'s sight cells; all hidden where it is withheld
    theta: Tensor  # (B, 3) float32 frame error in the window frame: x [m], y [m], yaw [rad]


class TrainingBatches(NumberedBatches[PerturbedPair, Batch]):
    """Batches for training; every epoch is a permutation of all pairs."""

    def __init__(self, pairs: PairTable, sampling: Sampling, *, seed: int, **shares: int) -> None:
        super().__init__(seed=seed, **shares)
        self.pairs, self.sampling = pairs, sampling
        self._order = EpochOrder(len(pairs), seed=seed)

    def sample(self, number: int) -> PerturbedPair:
        """One augmented pair, perturbed anew."""
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

    def batch(self, samples: list[PerturbedPair]) -> Batch:
        return _batch(samples)


def validation_batches(
    pairs: PairTable, sampling: Sampling, *, seed: int, count: int, batch_size: int
) -> list[Batch]:
    """Pairs as they are, evenly spread over the split, each under its fixed perturbation."""
    samples = [
        perturbed_pair(
            pair,
            evaluation_perturbation(pair.pair_id, sampling.perturbation, seed=seed),
            cells=sampling.window_cells,
            cell_m=sampling.window_cell_m,
        )
        for pair in (pairs[row] for row in evenly_spread(range(len(pairs)), count))
    ]
    return [_batch(samples[i : i + batch_size]) for i in range(0, len(samples), batch_size)]


def _batch(samples: list[PerturbedPair]) -> Batch:
    windows = [sample.window for sample in samples]
    cells: Cells = np.stack([window.cells for window in windows])
    sight = [np.zeros_like(w.cells) if w.sight is None else w.sight for w in windows]
    theta = np.array([sample.theta_v.as_array() for sample in samples], np.float32)
    return Batch(
        cells=torch.from_numpy(cells), sight=torch.from_numpy(np.stack(sight)), theta=torch.from_numpy(theta)
    )
