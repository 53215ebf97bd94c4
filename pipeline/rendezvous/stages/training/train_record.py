"""Validation points, checkpoints and progress of a training run."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, Generic, Protocol, TypeVar

from rich.console import Console
from rich.status import Status
from torch.utils.tensorboard import SummaryWriter

from rendezvous.config.sections import TrainingSection
from rendezvous.engine.progress import LINE_EVERY_S
from rendezvous.errors import StoreError
from rendezvous.geometry.camera import Image
from rendezvous.store.disk import Disk
from rendezvous.store.records import json_bytes
from rendezvous.training.checkpoint import checkpoint_bytes, weights_bytes
from rendezvous.training.loop import Model, Processes, Step, TrainableModel, TrainingState

CHECKPOINT, WEIGHTS, CURVE = "checkpoint.safetensors", "weights.safetensors", "curve.json"
"""To resume from; to use; error against training samples."""

_SCALARS_EVERY_STEPS = 10

ModelSeen = TypeVar("ModelSeen", bound=TrainableModel[Any], contravariant=True)


class Validation(Protocol[ModelSeen]):
    """Measures the averaged weights on samples that stay the same."""

    def figures(self, model: ModelSeen) -> Mapping[str, Any]:
        """Fields of the model's curve point."""

    def pictures(self, model: ModelSeen) -> Mapping[str, Image]:
        """Images for TensorBoard, by name."""


@dataclass(kw_only=True)
class Recorder(Generic[Model]):
    """Validates, saves and reports, in the first process only.

    A curve point is due after each of `validations` equal parts of the budget; a checkpoint is due with each
    point and every `checkpoint_every_s`.
    """

    folder: Path
    about: Mapping[str, Any]
    section: TrainingSection
    validation: Validation[Model]
    processes: Processes
    console: Console
    resumed_samples: int

    def __post_init__(self) -> None:
        self.budget = self.section.budget()
        self._disk, self._model = Disk(str(self.folder)), self.about["model"]
        # A killed run's events after its last checkpoint will come again: TensorBoard drops them.
        purge_step = self.resumed_samples + 1 if self.resumed_samples else None
        self._events = _events(self.folder, purge_step) if self.processes.first else None
        self._status: Status | None = None
        self._saved_s = self._reported_s = time.monotonic()
        self._rate_from: tuple[float, int] | None = None

    def __enter__(self) -> Recorder[Model]:
        if self.processes.first and self.console.is_terminal:
            self._status = self.console.status(f"train {self._model}")
            self._status.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._status is not None:
            self._status.stop()
        if self._events is not None:
            self._events.close()

    def after(self, state: TrainingState[Model], step: Step) -> None:
        """Do what is due after a step."""
        if not self.processes.first:
            return
        spent = self.budget.spent(state.samples, state.elapsed_s)
        self._report(state, step, spent)
        if state.step % _SCALARS_EVERY_STEPS == 0:
            self._write_scalars(state, step)
        parts = self.section.validations
        if int(spent * parts) > int(step.spent * parts):
            self._add_point(state)
            self._save(state)
        elif time.monotonic() - self._saved_s >= self.section.checkpoint_every_s:
            self._save(state)

    def finish(self, state: TrainingState[Model]) -> None:
        """Write the last point and the last checkpoint."""
        if not self.processes.first:
            return
        if state.loss_steps:
            self._add_point(state)
            self._save(state)
        self._say(f"{state.step} steps, {state.elapsed_s:.0f} s; {self._disk.shown(WEIGHTS)}")

    def _add_point(self, state: TrainingState[Model]) -> None:
        point = state.model.point(
            samples=state.samples,
            elapsed_s=round(state.elapsed_s, 3),
            training_loss=state.loss_sum / state.loss_steps,
            **self.validation.figures(state.average),
        )
        state.curve.append(point)
        state.loss_sum, state.loss_steps = 0.0, 0
        self._say(point.summary())
        if self._events is not None:
            for name, value in point.as_dict().items():
                if value is not None:
                    self._events.add_scalar(f"curve/{name}", value, state.samples)
            for name, picture in self.validation.pictures(state.average).items():
                self._events.add_image(name, picture, state.samples, dataformats="HWC")

    def _save(self, state: TrainingState[Model]) -> None:
        """Write weights, curve and checkpoint, in this order, so that no checkpoint is ahead of the others.

        The weights' record has the curve too, because a kill may leave the curve's file a point behind.
        """
        record = {**self.about, "curve": [point.as_dict() for point in state.curve]}
        self._disk.write(WEIGHTS, weights_bytes(state, record))
        self._disk.write(CURVE, json_bytes({**record, "samples": state.samples}))
        self._disk.write(CHECKPOINT, checkpoint_bytes(state, self.about))
        self._saved_s = time.monotonic()

    def _write_scalars(self, state: TrainingState[Model], step: Step) -> None:
        assert self._events is not None
        scalars = {
            "loss": step.loss,
            "gradient_norm": step.gradient_norm,
            "learning_rate": step.learning_rate,
            **step.figures,
        }
        for name, value in scalars.items():
            self._events.add_scalar(f"train/{name}", value, state.samples)

    def _report(self, state: TrainingState[Model], step: Step, spent: float) -> None:
        """Report the rate and the time left, from this process's own steps."""
        now_s = time.monotonic()
        if self._rate_from is None:
            self._rate_from = (state.elapsed_s, state.samples)
            return
        due = self._status is not None or now_s - self._reported_s >= LINE_EVERY_S
        if not due or state.elapsed_s <= self._rate_from[0]:
            return
        self._reported_s = now_s
        per_s = (state.samples - self._rate_from[1]) / (state.elapsed_s - self._rate_from[0])
        left_s = state.elapsed_s * max(1.0 - spent, 0.0) / max(spent, 1e-9)
        line = (
            f"{state.samples} samples, {per_s:.1f}/s, loss {step.loss:.4g}, "
            f"{100.0 * min(spent, 1.0):.0f} % done, about {left_s:.0f} s left"
        )
        if self._status is not None:
            self._status.update(f"train {self._model}: {line}")
        else:
            self._say(line)

    def _say(self, line: str) -> None:
        self.console.print(f"train {self._model}: {line}", highlight=False, markup=False, soft_wrap=True)


def _events(folder: Path, purge_step: int | None) -> SummaryWriter:
    try:
        return SummaryWriter(str(folder), purge_step=purge_step)
    except OSError as error:
        reason = (error.strerror or str(error)).lower()
        raise StoreError(f"{folder}: {reason}; --out must name a folder that can be written to") from error
