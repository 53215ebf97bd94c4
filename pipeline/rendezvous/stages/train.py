"""Train the frame-error estimator on the published pairs, in one process or, under torchrun, in several."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch

from rendezvous.alignment.window import WINDOW_CELL_M
from rendezvous.engine.run import Run
from rendezvous.stages.training.calibrate import LEAST_PAIRS, calibrate
from rendezvous.stages.training.train_processes import joined_processes
from rendezvous.stages.training.train_record import WEIGHTS
from rendezvous.stages.training.training_run import about_run, begin_in_place, budget_of, fit_and_record, tell
from rendezvous.store.disk import Disk
from rendezvous.training.frame_error.data import TrainingBatches, validation_batches
from rendezvous.training.frame_error.pairs import PairTable, pairs_per_split, read_pairs
from rendezvous.training.frame_error.registry import DEFAULT_MODEL, build_model
from rendezvous.training.frame_error.validation import FrameErrorValidation
from rendezvous.training.loop import TrainingState
from rendezvous.training.model import FrameErrorModel
from rendezvous.training.parameters import Budget
from rendezvous.training.processes import Processes


def train(run: Run, *, out: Path | None = None, resume: bool = False) -> Path:
    """Train a model until its budget is spent; fit the matcher's confidence to the validation pairs then.

    Args:
        run: the `train` section, where the data lies, and how many cores to use.
        out: folder for checkpoint, weights, curve and TensorBoard's events; `runs/MODEL` by default.
        resume: go on from the folder's checkpoint, if there is one.

    Returns:
        The folder.

    Raises:
        ConfigError: a setting is wrong, or is not what the checkpoint was begun with.
        StoreError: the dataset or the checkpoint is missing or damaged, or the folder holds another run.
    """
    section, reader = run.config.train, run.read("pack")
    folder = out or Path(run.config.stages["train"].writes) / section.model
    budget = budget_of(section)
    with joined_processes() as processes:
        torch.set_num_threads(max(1, run.workers // processes.on_this_machine))
        model = build_model(section.model, section.settings, section.sampling, seed=run.config.seed)
        pairs = {split: read_pairs(reader, split) for split in ("train", "validation")}
        about = about_run(
            run,
            section,
            pairs,
            rows="pairs",
            model=section.model,
            network=model.config(),
            sampling=section.sampling,
        )
        state = TrainingState.fresh(model.to(processes.device), section.optimisation)
        begin_in_place(state, Disk(str(folder)), about, resume=resume)
        if processes.first:
            counts = pairs_per_split(reader)
            tell(run, about, section, state, processes, rows="pairs", counts=counts)
        _fit(run, state, budget, pairs, about, folder, processes)
    if processes.first and section.model == DEFAULT_MODEL:
        _calibrate(run, len(pairs["validation"]), folder)
    return folder


def _calibrate(run: Run, validation_pairs: int, folder: Path) -> None:
    """Fit the confidence where that is possible: on enough pairs, in the windows that are evaluated."""
    cell_m = run.config.train.sampling.window_cell_m
    if validation_pairs < LEAST_PAIRS:
        run.say(f"calibrate: left out, {validation_pairs} validation pairs; it takes {LEAST_PAIRS}")
        return
    if not math.isclose(cell_m, WINDOW_CELL_M):
        run.say(f"calibrate: left out, trained on cells of {cell_m} m; it takes {WINDOW_CELL_M} m")
        return
    weights, dataset = folder / WEIGHTS, run.folder("pack")
    calibrate(weights, dataset, seed=run.config.seed, threads=run.workers, console=run.console)


def _fit(
    run: Run,
    state: TrainingState[FrameErrorModel],
    budget: Budget,
    pairs: Mapping[str, PairTable],
    about: Mapping[str, Any],
    folder: Path,
    processes: Processes,
) -> None:
    section, seed = run.config.train, run.config.seed
    batches = TrainingBatches(
        pairs["train"],
        section.sampling,
        seed=seed,
        batch_size=section.optimisation.batch_size,
        rank=processes.rank,
        processes=processes.count,
    )
    measured = validation_batches(
        pairs["validation"], section.sampling, seed=seed, count=section.validation_pairs, batch_size=16
    )
    validation = FrameErrorValidation(batches=measured, device=processes.device, seed=seed)
    fit_and_record(run, section, state, budget, batches, validation, about, folder, processes)
