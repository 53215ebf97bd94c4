"""Train the frame-error estimator on the published pairs, in one process or, under torchrun, in several."""

from __future__ import annotations

import math
from dataclasses import asdict
from functools import partial
from pathlib import Path

from rendezvous.alignment.window import WINDOW_CELL_M
from rendezvous.engine.run import Run
from rendezvous.stages.training.calibrate import LEAST_PAIRS, calibrate
from rendezvous.stages.training.train_record import WEIGHTS
from rendezvous.stages.training.training_run import joined_processes, train_in_folder
from rendezvous.training.frame_error.data import TrainingBatches, validation_batches
from rendezvous.training.frame_error.pairs import read_pairs
from rendezvous.training.frame_error.registry import DEFAULT_MODEL, FrameErrorValidation, build_model


def train(run: Run, *, out: Path | None = None, resume: bool = False) -> Path:
    """Train a model until its budget is spent; fit the matcher's confidence to the validation pairs then.

    Returns the folder.

    Args:
        run: the `train` section, where the data lies, and how many cores to use.
        out: folder for checkpoint, weights, curve and TensorBoard's events; `runs/MODEL` by default.
        resume: go on from the folder's checkpoint, if there is one.

    Raises:
        ConfigError: a setting is wrong, or is not what the checkpoint was begun with.
        StoreError: the dataset or the checkpoint is missing or damaged, or the folder holds another run.
    """
    section, reader, seed = run.config.train, run.read("pack"), run.config.seed
    with joined_processes(run.workers) as processes:
        model = build_model(section.model, section.settings, section.sampling, seed=seed)
        pairs = {split: read_pairs(reader, split) for split in ("train", "validation")}
        measured = validation_batches(
            pairs["validation"], section.sampling, seed=seed, count=section.validation_pairs, batch_size=16
        )
        folder = train_in_folder(
            run,
            section,
            model,
            pairs,
            partial(TrainingBatches, pairs["train"], section.sampling),
            FrameErrorValidation(batches=measured, device=processes.device, seed=seed),
            name=section.model,
            rows="pairs",
            out=out,
            resume=resume,
            processes=processes,
            sampling=asdict(section.sampling),
        )
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
