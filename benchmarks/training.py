"""Training of the default model: drawing samples, learning from them, and both at once."""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from itertools import islice, repeat
from typing import Any

import numpy as np
import pyarrow as pa
import torch

from rendezvous.geometry.occupancy_grid import FREE, OCCUPIED, UNKNOWN, OccupancyGrid
from rendezvous.geometry.se2 import SE2
from rendezvous.schema import IMAGE_TYPE, SE2_TYPE
from rendezvous.training.batches import training_loader
from rendezvous.training.frame_error.data import Batch, TrainingBatches
from rendezvous.training.frame_error.pairs import PairTable
from rendezvous.training.frame_error.registry import DEFAULT_MODEL, build_model
from rendezvous.training.loop import Processes, Step, TrainingState, fit
from rendezvous.training.parameters import Budget, Optimisation, Sampling

STEPS, WARM_UP_STEPS, PAIRS = 16, 2, 64


def measure(options: argparse.Namespace) -> dict[str, Any]:
    """Samples per second of the loader with one worker, of the model alone, and of training."""
    cores = len(os.sched_getaffinity(0))
    torch.set_num_threads(cores)
    settings = Optimisation()
    loader = _loader(synthetic_pairs(), settings)
    loading = _samples_per_s(loader, settings)
    bare = _trained(repeat(next(iter(loader))), settings)
    both = _trained(loader, settings)
    return {
        "model": DEFAULT_MODEL,
        "threads": cores,
        "batch_size": settings.batch_size,
        "loader_samples_per_s": round(loading, 1),
        "model_samples_per_s": round(bare.samples_per_s, 2),
        "training_samples_per_s": round(both.samples_per_s, 2),
        "waiting_for_samples_share": round(both.waiting_share, 4),
    }


def _loader(pairs: PairTable, settings: Optimisation) -> Iterable[Batch]:
    batches = TrainingBatches(pairs, Sampling(), seed=0, batch_size=settings.batch_size)
    return training_loader(batches, first_step=0, workers=1, pin_memory=False)


def _samples_per_s(loader: Iterable[Batch], settings: Optimisation) -> float:
    """Samples per second of the loader alone."""
    batches = iter(loader)
    for _ in islice(batches, WARM_UP_STEPS + 4):  # those that were drawn ahead
        pass
    started_s = time.perf_counter()
    for _ in islice(batches, 4 * STEPS):
        pass
    return 4 * STEPS * settings.batch_size / (time.perf_counter() - started_s)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Pace:
    """Samples per second of the loop, and the share of its time in which it waits for a batch."""

    samples_per_s: float
    waiting_share: float


def _trained(batches: Iterable[Batch], settings: Optimisation) -> _Pace:
    """The pace of the loop over some steps, without the first ones."""
    state = TrainingState.fresh(build_model(DEFAULT_MODEL, {}, Sampling(), seed=0), settings)
    watch = _Watch(batches)
    fit(
        state,
        watch,
        settings,
        Budget(samples=(STEPS + WARM_UP_STEPS) * settings.batch_size, duration_s=None),
        seed=0,
        processes=Processes(),
        observer=watch,
        clock=time.monotonic,
    )
    took_s = watch.after_s[-1] - watch.after_s[WARM_UP_STEPS - 1]
    waited_s = sum(watch.waits_s[WARM_UP_STEPS : WARM_UP_STEPS + STEPS])
    return _Pace(samples_per_s=STEPS * settings.batch_size / took_s, waiting_share=waited_s / took_s)


class _Watch:
    """Times the steps and the waits for their batches."""

    def __init__(self, batches: Iterable[Batch]) -> None:
        self._batches = batches
        self.waits_s: list[float] = []
        self.after_s: list[float] = []

    def __iter__(self) -> Iterator[Batch]:
        batches = iter(self._batches)
        while True:
            started_s = time.perf_counter()
            batch = next(batches)
            self.waits_s.append(time.perf_counter() - started_s)
            yield batch

    def after(self, state: TrainingState, step: Step) -> None:
        self.after_s.append(time.perf_counter())


def synthetic_pairs() -> PairTable:
    """Pairs of two overlapping rooms each, 9 m across, as large as those of the default preset."""
    rows = list(_rows())
    columns = {name: [row[name] for row in rows] for name in rows[0]}
    types = {"map_0": IMAGE_TYPE, "map_1": IMAGE_TYPE} | dict.fromkeys(
        ("origin_0", "origin_1", "T_m0_r0", "T_m1_r1", "T_m0_m1_local"), SE2_TYPE
    )
    return PairTable(
        "train", pa.table({name: pa.array(values, types.get(name)) for name, values in columns.items()})
    )


def _rows() -> Iterator[dict[str, Any]]:
    rng = np.random.default_rng(0)
    for number in range(PAIRS):
        cells = np.full((180, 180), UNKNOWN, np.uint8)
        cells[4:-4, 4:-4] = OCCUPIED
        cells[5:-5, 5:-5] = FREE
        for row, col in rng.integers(10, 160, (40, 2)):
            cells[row : row + rng.integers(1, 40), col] = OCCUPIED
        grid = OccupancyGrid(cells=cells, resolution_m=0.05, T_m_g=SE2(-4.5, -4.5, 0.0))
        png = {"bytes": grid.png(), "path": None}
        yield {
            "pair_id": f"pair-{number}",
            "plan_id": "plan",
            "plan_digest": "plan",
            "seed": 0,
            "map_0": png,
            "map_1": png,
            "origin_0": [-4.5, -4.5, 0.0],
            "origin_1": [-4.5, -4.5, 0.0],
            "resolution_m": 0.05,
            "T_m0_r0": [-1.0, 0.5, 0.0],
            "T_m1_r1": [0.0, 0.0, 0.0],
            "T_m0_m1_local": [1.0, 0.5, 0.3],
            "overlap": 0.6,
        }
