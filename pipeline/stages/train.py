"""Train the frame-error estimator on the published pairs, in one process or, under torchrun, in several."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import torch

from pipeline.alignment.window import WINDOW_CELL_M
from pipeline.config import TrainSection
from pipeline.engine import Run
from pipeline.errors import ConfigError, StoreError
from pipeline.stages.calibrate import LEAST_PAIRS, calibrate
from pipeline.stages.train_processes import joined_processes
from pipeline.stages.train_record import CHECKPOINT, WEIGHTS, Recorder
from pipeline.store.disk import Disk
from pipeline.store.records import digest_of
from pipeline.training.checkpoint import read_checkpoint, restore_in_place
from pipeline.training.data import TrainingBatches, training_loader, validation_batches
from pipeline.training.loop import TrainingState, fit
from pipeline.training.model import FrameErrorModel
from pipeline.training.pairs import PairTable, pairs_per_split, read_pairs
from pipeline.training.parameters import Budget
from pipeline.training.processes import Processes
from pipeline.training.registry import DEFAULT_MODEL, build_model

_DIGITS = 12
"""Of digests that are told and kept."""
_MAY_CHANGE = (
    "minutes",
    "samples",
    "validations",
    "validation_pairs",
    "checkpoint_every_s",
)
"""What may be set otherwise when a run goes on: how long it lasts and how it is watched."""


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
    budget = _budget(section)
    with joined_processes() as processes:
        torch.set_num_threads(max(1, run.workers // processes.on_this_machine))
        model = build_model(section.model, section.settings, section.sampling, seed=run.config.seed)
        pairs = {split: read_pairs(reader, split) for split in ("train", "validation")}
        about = _about(run, model, pairs)
        state = TrainingState.fresh(model.to(processes.device), section.optimisation)
        _begin(state, Disk(str(folder)), about, resume=resume)
        if processes.first:
            _tell(run, about, pairs_per_split(reader), state, processes)
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
    state: TrainingState,
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
    validation = validation_batches(
        pairs["validation"], section.sampling, seed=seed, count=section.validation_pairs, batch_size=16
    )
    loader = training_loader(
        batches,
        first_step=state.step,
        workers=_loader_workers(run.workers // processes.on_this_machine),
        pin_memory=processes.device.type == "cuda",
    )
    with Recorder(
        folder=folder,
        about=about,
        section=section,
        budget=budget,
        validation=validation,
        processes=processes,
        console=run.console,
        seed=seed,
        resumed_samples=state.samples,
    ) as recorder:
        fit(
            state,
            loader,
            section.optimisation,
            budget,
            seed=seed,
            processes=processes,
            observer=recorder,
            clock=time.monotonic,
        )
        recorder.finish(state)


def _about(run: Run, model: FrameErrorModel, pairs: Mapping[str, PairTable]) -> dict[str, Any]:
    """What is trained on what: the part of a checkpoint that does not change."""
    section = run.config.train
    return {
        "model": section.model,
        "network": model.config(),
        "sampling": asdict(section.sampling),
        "parameters": section.parameters(exclude=_MAY_CHANGE),
        "seed": run.config.seed,
        "data": {
            "folder": run.folder("pack"),
            "digest": digest_of({split: table.digest() for split, table in pairs.items()}),
            "pairs": {split: len(table) for split, table in pairs.items()},
            "plans": {split: len(table.plan_digests()) for split, table in pairs.items()},
            "plan_digests": [digest[:_DIGITS] for digest in pairs["train"].plan_digests()],
            "seeds": sorted({seed for table in pairs.values() for seed in table.seeds()}),
        },
        "torch": torch.__version__,
    }


def _begin(state: TrainingState, disk: Disk, about: Mapping[str, Any], *, resume: bool) -> None:
    """Bring the state to the folder's checkpoint, if it shall go on from there.

    Raises:
        StoreError: the folder holds a run that shall not go on, or its checkpoint is damaged.
        ConfigError: the checkpoint was begun with other settings or data.
    """
    where = disk.shown(CHECKPOINT)
    if disk.size(CHECKPOINT) is None:
        return
    if not resume:
        raise StoreError(
            f"{where}: a run is here already; --resume goes on with it, --out names another folder"
        )
    checkpoint = read_checkpoint(disk.read(CHECKPOINT), where=where)
    _check_same(checkpoint.record, about, where)
    restore_in_place(state, checkpoint, where=where)


def _check_same(record: Mapping[str, Any], about: Mapping[str, Any], where: str) -> None:
    begun, now = (
        {
            **told["parameters"],
            **{f"network.{key}": value for key, value in told["network"].items()},
            "seed": told["seed"],
            "data": told["data"]["digest"][:_DIGITS],
        }
        for told in (record, about)
    )
    for key in {**begun, **now}:
        if begun.get(key) != now.get(key):
            raise ConfigError(
                f"{where}: begun with {key} {begun.get(key)}, now it is {now.get(key)}; to go on, set it as "
                "it was; to begin anew, name another folder with --out (make: OUT=FOLDER) or delete this one"
            )


def _budget(section: TrainSection) -> Budget:
    """When training ends.

    Raises:
        ConfigError: nothing ends it.
    """
    if section.minutes is None and section.samples is None:
        raise ConfigError("train.minutes and train.samples are both null; one of them must end the training")
    duration_s = None if section.minutes is None else 60.0 * section.minutes
    return Budget(samples=section.samples, duration_s=duration_s)


def _tell(
    run: Run,
    about: Mapping[str, Any],
    counts: Mapping[str, int],
    state: TrainingState,
    processes: Processes,
) -> None:
    """Say what is trained, on which data, where, and from when on."""
    section, data = run.config.train, about["data"]
    seeds = ", ".join(str(seed) for seed in data["seeds"])
    weights = sum(p.numel() for p in state.model.parameters())
    run.say(
        f"train {section.model}: {weights} weights, seed {run.config.seed}, {processes.count} x "
        f"{processes.device.type}, {torch.get_num_threads()} threads, {section.optimisation.precision}"
    )
    run.say(
        f"train {section.model}: pairs of {data['folder']}: "
        + ", ".join(f"{count} {split}" for split, count in counts.items())
        + f"; {data['plans']['train']} plans to train on, made with seed {seeds}, "
        f"digest {data['digest'][:_DIGITS]}"
    )
    if state.step:
        run.say(f"train {section.model}: goes on from {state.samples} samples, {state.elapsed_s:.0f} s")


def _loader_workers(cores: int) -> int:
    """Processes that draw samples: one keeps a CPU's network busy, a GPU takes as many as there are cores."""
    return max(1, cores - 1) if torch.cuda.is_available() else 1
