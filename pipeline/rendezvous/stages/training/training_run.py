"""A training run: join its processes, begin or resume it, train until its budget is spent."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import torch
from torch import distributed as dist
from torch.utils.data import Dataset

from rendezvous.config.sections import TrainingSection
from rendezvous.engine.run import Run
from rendezvous.errors import ConfigError, StoreError
from rendezvous.stages.training.train_record import CHECKPOINT, Recorder, Validation
from rendezvous.store.disk import Disk
from rendezvous.store.records import digest_of
from rendezvous.training.batches import AnyBatch, training_loader
from rendezvous.training.checkpoint import read_checkpoint, restore_in_place
from rendezvous.training.loop import Model, Processes, TrainingState, fit, with_precision
from rendezvous.training.published_rows import PublishedRows, rows_per_split

_DIGITS = 12  # length to which digests are cut in messages and records
_MAY_CHANGE = (
    "minutes",
    "samples",
    "validations",
    "validation_pairs",
    "validation_images",
    "checkpoint_every_s",
)
"""Parameters that may change when a run is resumed: how long it lasts and how it is watched."""


@contextmanager
def joined_processes(threads: int) -> Iterator[Processes]:
    """This process among those of one training run: alone unless torchrun started it."""
    local_rank = int(os.environ.get("LOCAL_RANK", "0"))
    device = torch.device("cuda", local_rank) if torch.cuda.is_available() else torch.device("cpu")
    if device.type == "cuda":
        torch.cuda.set_device(device)
    if "WORLD_SIZE" not in os.environ:
        torch.set_num_threads(threads)
        yield Processes(device=device)
        return
    on_this_machine = int(os.environ["LOCAL_WORLD_SIZE"])
    torch.set_num_threads(max(1, threads // on_this_machine))
    dist.init_process_group("nccl" if device.type == "cuda" else "gloo")
    try:
        yield Processes(
            rank=dist.get_rank(), count=dist.get_world_size(), on_this_machine=on_this_machine, device=device
        )
    finally:
        dist.destroy_process_group()


def _about_data(
    run: Run,
    section: TrainingSection,
    tables: Mapping[str, PublishedRows],
    rows: str,
    seen_before: Sequence[str],
) -> dict[str, Any]:
    """Parameters and data of a run; with its model they are the part of a checkpoint that never changes."""
    return {
        "parameters": section.parameters(exclude=_MAY_CHANGE),
        "seed": run.config.seed,
        "data": {
            "folder": run.folder("pack"),
            "digest": digest_of({split: table.digest() for split, table in tables.items()}),
            rows: {split: len(table) for split, table in tables.items()},
            "plans": {split: len(table.plan_digests()) for split, table in tables.items()},
            # With those of the weights that it starts from.
            "plan_digests": sorted({*(d[:_DIGITS] for d in tables["train"].plan_digests()), *seen_before}),
            "seeds": sorted({seed for table in tables.values() for seed in table.seeds()}),
        },
        "torch": torch.__version__,
    }


def _begin_in_place(state: TrainingState[Any], disk: Disk, about: Mapping[str, Any], *, resume: bool) -> None:
    """Bring the state to the folder's checkpoint, if there is one."""
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
            **entry["parameters"],
            **{f"network.{key}": value for key, value in entry["network"].items()},
            "seed": entry["seed"],
            "data": entry["data"]["digest"][:_DIGITS],
        }
        for entry in (record, about)
    )
    for key in {**begun, **now}:
        if begun.get(key) != now.get(key):
            raise ConfigError(
                f"{where}: begun with {key} {begun.get(key)}, now it is {now.get(key)}; to go on, set it as "
                "it was; to begin anew, name another folder with --out (make: OUT=FOLDER) or delete this one"
            )


def train_in_folder(
    run: Run,
    section: TrainingSection,
    model: Model,
    tables: Mapping[str, PublishedRows],
    batches: Callable[..., Dataset[AnyBatch]],
    validation: Validation[Model],
    *,
    name: str,
    rows: str,
    out: Path | None,
    resume: bool,
    processes: Processes,
    seen_before: Sequence[str] = (),
    **more: Any,
) -> Path:
    """Train until the budget is spent; checkpoint, weights, curve and events go into the folder.

    Raises:
        StoreError: the folder holds another run, or its checkpoint is damaged.
        ConfigError: the checkpoint was begun with other parameters or data, or the budget ended before the
            first step.
    """
    folder = out or Path(run.config.stages[section.stage()].writes) / name
    optimisation = with_precision(section.optimisation, processes.device)
    section = section.model_copy(update={"optimisation": optimisation})
    about = {
        "model": name,
        "network": model.config(),
        **more,
        **_about_data(run, section, tables, rows, seen_before),
    }
    state = TrainingState.fresh(model.to(processes.device), section.optimisation)
    _begin_in_place(state, Disk(str(folder)), about, resume=resume)
    if processes.first:
        _announce(run, about, section, state, processes, rows=rows)
    recorder = Recorder(
        folder=folder,
        about=about,
        section=section,
        validation=validation,
        processes=processes,
        console=run.console,
        resumed_samples=state.samples,
    )
    _train(run, section, state, batches, recorder)
    return folder


def _train(
    run: Run,
    section: TrainingSection,
    state: TrainingState[Model],
    batches: Callable[..., Dataset[AnyBatch]],
    recorder: Recorder[Model],
) -> None:
    processes, seed = recorder.processes, run.config.seed
    cores = run.workers // processes.on_this_machine
    loader = training_loader(
        batches(
            seed=seed,
            batch_size=section.optimisation.batch_size,
            rank=processes.rank,
            processes=processes.count,
        ),
        first_step=state.step,
        # One keeps a CPU's network busy; a GPU takes as many as there are cores.
        workers=max(1, cores - 1) if torch.cuda.is_available() else 1,
        pin_memory=processes.device.type == "cuda",
    )
    with recorder:
        fit(
            state,
            loader,
            section.optimisation,
            recorder.budget,
            seed=seed,
            processes=processes,
            observer=recorder,
            clock=time.monotonic,
        )
        if not state.step:
            raise ConfigError(
                f"train {recorder.about['model']}: not one step was made within {section.minutes} minutes, "
                f"so nothing is written; raise {section.stage()}.minutes (--minutes)"
            )
        recorder.finish(state)


def _announce(
    run: Run,
    about: Mapping[str, Any],
    section: TrainingSection,
    state: TrainingState[Any],
    processes: Processes,
    *,
    rows: str,
) -> None:
    data, name = about["data"], about["model"]
    seeds = ", ".join(str(seed) for seed in data["seeds"])
    weights = sum(p.numel() for p in state.model.parameters())
    run.say(
        f"train {name}: {weights} weights, seed {run.config.seed}, {processes.count} x "
        f"{processes.device.type}, {torch.get_num_threads()} threads, {section.optimisation.precision}"
    )
    run.say(
        f"train {name}: {rows} of {data['folder']}: "
        + ", ".join(f"{count} {split}" for split, count in rows_per_split(run.read("pack"), rows).items())
        + f"; {data['plans']['train']} plans to train on, made with seed {seeds}, "
        f"digest {data['digest'][:_DIGITS]}"
    )
    if state.step:
        run.say(f"train {name}: goes on from {state.samples} samples, {state.elapsed_s:.0f} s")
