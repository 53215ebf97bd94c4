"""What the stages that train have in common: when they end, how they go on, what they say."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import torch
from torch.utils.data import Dataset

from rendezvous.config.sections import TrainingSection
from rendezvous.engine.run import Run
from rendezvous.errors import ConfigError, StoreError
from rendezvous.stages.training.train_record import CHECKPOINT, Recorder, Validation
from rendezvous.store.disk import Disk
from rendezvous.store.records import digest_of
from rendezvous.training.batches import AnyBatch, training_loader
from rendezvous.training.checkpoint import read_checkpoint, restore_in_place
from rendezvous.training.loop import Model, TrainingState, fit
from rendezvous.training.parameters import Budget
from rendezvous.training.processes import Processes
from rendezvous.training.published_rows import PublishedRows

_DIGITS = 12
"""Of digests that are told and kept."""
_MAY_CHANGE = (
    "minutes",
    "samples",
    "validations",
    "validation_pairs",
    "validation_images",
    "checkpoint_every_s",
)
"""What may be set otherwise when a run goes on: how long it lasts and how it is watched."""


def budget_of(section: TrainingSection) -> Budget:
    """When training ends.

    Raises:
        ConfigError: nothing ends it.
    """
    if section.minutes is None and section.samples is None:
        name = section.stage()
        raise ConfigError(
            f"{name}.minutes and {name}.samples are both null; one of them must end the training"
        )
    duration_s = None if section.minutes is None else 60.0 * section.minutes
    return Budget(samples=section.samples, duration_s=duration_s)


def about_run(
    run: Run,
    section: TrainingSection,
    tables: Mapping[str, PublishedRows],
    *,
    rows: str,
    sampling: object,
    **more: Any,
) -> dict[str, Any]:
    """What is trained on what: the part of a checkpoint that does not change.

    Args:
        run: its seed and where the data lies.
        section: the settings.
        tables: rows by their split.
        rows: what these are: `pairs`.
        sampling: record of how samples are drawn from them.
        more: the model's name and network, and what else its weights shall tell.
    """
    return {
        **more,
        "sampling": asdict(sampling),  # type: ignore[call-overload]
        "parameters": section.parameters(exclude=_MAY_CHANGE),
        "seed": run.config.seed,
        "data": {
            "folder": run.folder("pack"),
            "digest": digest_of({split: table.digest() for split, table in tables.items()}),
            rows: {split: len(table) for split, table in tables.items()},
            "plans": {split: len(table.plan_digests()) for split, table in tables.items()},
            "plan_digests": [digest[:_DIGITS] for digest in tables["train"].plan_digests()],
            "seeds": sorted({seed for table in tables.values() for seed in table.seeds()}),
        },
        "torch": torch.__version__,
    }


def begin_in_place(state: TrainingState[Any], disk: Disk, about: Mapping[str, Any], *, resume: bool) -> None:
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


def tell(
    run: Run,
    about: Mapping[str, Any],
    section: TrainingSection,
    state: TrainingState[Any],
    processes: Processes,
    *,
    rows: str,
    counts: Mapping[str, int],
) -> None:
    """Say what is trained, on which data, where, and from when on."""
    data, name = about["data"], about["model"]
    seeds = ", ".join(str(seed) for seed in data["seeds"])
    weights = sum(p.numel() for p in state.model.parameters())
    run.say(
        f"train {name}: {weights} weights, seed {run.config.seed}, {processes.count} x "
        f"{processes.device.type}, {torch.get_num_threads()} threads, {section.optimisation.precision}"
    )
    run.say(
        f"train {name}: {rows} of {data['folder']}: "
        + ", ".join(f"{count} {split}" for split, count in counts.items())
        + f"; {data['plans']['train']} plans to train on, made with seed {seeds}, "
        f"digest {data['digest'][:_DIGITS]}"
    )
    if state.step:
        run.say(f"train {name}: goes on from {state.samples} samples, {state.elapsed_s:.0f} s")


def fit_and_record(
    run: Run,
    section: TrainingSection,
    state: TrainingState[Model],
    budget: Budget,
    batches: Dataset[AnyBatch],
    validation: Validation[Model],
    about: Mapping[str, Any],
    folder: Path,
    processes: Processes,
) -> None:
    """Train until the budget is spent, with all that is written on the way."""
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
        resumed_samples=state.samples,
    ) as recorder:
        fit(
            state,
            loader,
            section.optimisation,
            budget,
            seed=run.config.seed,
            processes=processes,
            observer=recorder,
            clock=time.monotonic,
        )
        recorder.finish(state)


def _loader_workers(cores: int) -> int:
    """Processes that draw samples: one keeps a CPU's network busy, a GPU takes as many as there are cores."""
    return max(1, cores - 1) if torch.cuda.is_available() else 1
