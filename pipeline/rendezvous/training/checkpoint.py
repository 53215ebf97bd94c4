"""Checkpoints and published weights as bytes: safetensors, with everything else as JSON in the header.

One file holds it all, so that no kill can leave weights beside the record of another step.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Mapping
from dataclasses import dataclass
from math import inf
from typing import Any

import safetensors
import safetensors.torch
import torch
from torch import Tensor, nn

from rendezvous.errors import ConfigError, StoreError
from rendezvous.training.loop import TrainingState

_FORMAT = 2
_RECORD = "rendezvous"
_NO_CHECKPOINT = (AttributeError, KeyError, TypeError, ValueError, RecursionError, RuntimeError)
"""Raised where a file holds something else than a checkpoint."""
_PROGRESS = ("step", "samples", "elapsed_s", "loss_sum", "loss_steps")


@dataclass(frozen=True, slots=True, kw_only=True)
class Checkpoint:
    """Contents of a file.

    In a checkpoint names of tensors start with `model.`, `average.` or `optimizer.`, in weights not.
    """

    record: dict[str, Any]
    tensors: dict[str, Tensor]

    def under(self, prefix: str) -> dict[str, Tensor]:
        """The tensors whose names start with the prefix, by the rest of the name."""
        return {k.removeprefix(prefix): v for k, v in self.tensors.items() if k.startswith(prefix)}


def checkpoint_bytes(state: TrainingState[Any], about: Mapping[str, Any]) -> bytes:
    """The whole state of a run."""
    moments = {
        f"optimizer.{index}.{name}": value
        for index, values in state.optimizer.state_dict()["state"].items()
        for name, value in values.items()
    }
    tensors = _named("model.", state.model) | _named("average.", state.average) | moments
    progress = {name: getattr(state, name) for name in _PROGRESS}
    return _bytes(tensors, {**about, **progress, "curve": [point.as_dict() for point in state.curve]})


def weights_bytes(state: TrainingState[Any], about: Mapping[str, Any]) -> bytes:
    """The averaged weights alone, for use."""
    return _bytes(_named("", state.average), {**about, "step": state.step, "samples": state.samples})


def read_checkpoint(data: bytes, *, where: str) -> Checkpoint:
    """Inverse of `checkpoint_bytes` and `weights_bytes`.

    Raises:
        StoreError: the file is truncated, was written by something else, or holds a weight that is no number.
    """
    try:
        tensors = safetensors.torch.load(data)
        (length,) = struct.unpack("<Q", data[:8])
        record = json.loads(json.loads(data[8 : 8 + length])["__metadata__"][_RECORD])
        if not isinstance(record, dict):
            raise TypeError("its record is no object")
    except (*_NO_CHECKPOINT, safetensors.SafetensorError, struct.error) as error:
        raise StoreError(
            f"{where}: {len(data)} bytes that are no whole checkpoint ({' '.join(str(error).split())}); "
            "it may have been cut off while it was copied: copy it again, or train anew"
        ) from error
    if record.get("format") != _FORMAT:
        raise StoreError(
            f"{where}: of format {record.get('format')}; must be {_FORMAT}: train anew, in another folder or "
            "after this one is deleted"
        )
    for name, tensor in tensors.items():
        if tensor.is_floating_point() and not bool(torch.isfinite(tensor).all()):
            raise StoreError(f"{where}: {name} holds NaN or infinity; copy it again, or train anew")
    return Checkpoint(record=record, tensors=tensors)


def with_record(checkpoint: Checkpoint, **more: Any) -> bytes:
    """The same file with more in its record."""
    return _bytes(checkpoint.tensors, {**checkpoint.record, **more})


def restore_in_place(state: TrainingState[Any], checkpoint: Checkpoint, *, where: str) -> None:
    """Bring a fresh state to the one in a checkpoint.

    Raises:
        ConfigError: the weights do not fit the model.
        StoreError: the record of the run is not what a run writes.
    """
    fit_weights_in_place(state.model, checkpoint.under("model."), where=where)
    fit_weights_in_place(state.average, checkpoint.under("average."), where=where)
    try:
        _restore_progress_in_place(state, checkpoint)
    except _NO_CHECKPOINT as error:
        raise StoreError(
            f"{where}: its record of the run has a wrong or missing entry ({error}); train anew, in another "
            "folder or after this one is deleted"
        ) from error


def _restore_progress_in_place(state: TrainingState[Any], checkpoint: Checkpoint) -> None:
    moments: dict[int, dict[str, Tensor]] = {}
    for key, value in checkpoint.under("optimizer.").items():
        index, name = key.split(".", 1)
        moments.setdefault(int(index), {})[name] = value
    groups = state.optimizer.state_dict()["param_groups"]
    state.optimizer.load_state_dict({"state": moments, "param_groups": groups})
    for name in _PROGRESS:
        kind = type(getattr(state, name))
        value = checkpoint.record[name]
        if isinstance(value, bool) or not isinstance(value, (int, kind)) or value < 0 or value == inf:
            raise TypeError(f"{name} is {value!r:.60}")
        setattr(state, name, value)
    state.curve = [state.model.point(**point) for point in checkpoint.record["curve"]]


def fit_weights_in_place(model: nn.Module, weights: Mapping[str, Tensor], *, where: str) -> None:
    """Load weights into a model.

    Raises:
        ConfigError: they are another model's; names the first that does not fit.
    """
    require_fit(model, weights, where=where)
    model.load_state_dict(dict(weights))


def require_fit(model: nn.Module, weights: Mapping[str, Tensor], *, where: str) -> None:
    """Check names and shapes; the model may be on the device `meta`, where it takes no memory.

    Raises:
        ConfigError: they are another model's; names the first that does not fit.
    """
    wanted = model.state_dict()
    for name in sorted({*wanted, *weights}):
        have = tuple(weights[name].shape) if name in weights else None
        right = tuple(wanted[name].shape) if name in wanted else None
        if have != right:
            raise ConfigError(
                f"{where}: its weights do not fit the model as configured: {name} is {_shown(have)}; "
                f"must be {_shown(right)}"
            )


def _shown(shape: tuple[int, ...] | None) -> str:
    return "absent" if shape is None else f"of shape {shape}"


def _named(prefix: str, model: nn.Module) -> dict[str, Tensor]:
    return {prefix + name: value for name, value in model.state_dict().items()}


def _bytes(tensors: Mapping[str, Tensor], record: Mapping[str, Any]) -> bytes:
    own = {name: value.detach().to("cpu", copy=True).contiguous() for name, value in tensors.items()}
    text = json.dumps({"format": _FORMAT, **record}, allow_nan=False)
    return safetensors.torch.save(own, metadata={_RECORD: text})
