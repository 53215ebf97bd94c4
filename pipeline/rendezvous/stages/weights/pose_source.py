"""Sources of relative-pose estimators that worker processes can load."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from rendezvous.errors import ConfigError, StoreError, needs_extra
from rendezvous.geometry.se2 import Array
from rendezvous.pose_estimation.pose_estimate import ImagePoseEstimator
from rendezvous.resources import WEIGHTS
from rendezvous.store.disk import Disk

SHIPPED_POSE_WEIGHTS = WEIGHTS / "relative_pose.safetensors"
TRAINED_POSE_WEIGHTS = Path("runs/relative-pose/weights.safetensors")


class PoseSource(Protocol):
    """Makes an estimator. Small to pickle; sources of equal estimators are equal.

    Its methods raise `PipelineError` where the weights cannot be read, or PyTorch is missing.
    """

    @property
    def digest(self) -> str:
        """SHA-256 of the weights."""

    def estimator(self, *, floor: bool) -> ImagePoseEstimator:
        """The estimator; with `floor` it assumes that the seen robot stands on the observer's floor."""

    def record(self) -> dict[str, Any]:
        """The record of the training."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PoseWeights:
    """Weights written by `rendezvous train-pose`."""

    path: Path
    digest: str

    @staticmethod
    def found(path: Path | None) -> PoseWeights:
        """The weights in a file; by default those in `runs/`, or else the shipped ones.

        Raises:
            StoreError: there is no such file.
        """
        places = (path,) if path else (TRAINED_POSE_WEIGHTS, SHIPPED_POSE_WEIGHTS)
        there = next((place for place in places if place.is_file()), None)
        if there is None:
            shown = " or ".join(str(place) for place in places)
            raise StoreError(
                f"{shown}: no weights of the relative-pose estimator; `rendezvous train-pose` "
                "(`make train-pose`) makes them"
            )
        return PoseWeights(path=there, digest=hashlib.sha256(_bytes(there)).hexdigest())

    def estimator(self, *, floor: bool) -> ImagePoseEstimator:
        """The estimator, limited to one thread."""
        return _loaded(self, floor)

    def record(self) -> dict[str, Any]:
        _require_torch()
        from rendezvous.training.checkpoint import read_checkpoint

        return dict(read_checkpoint(_bytes(self.path), where=str(self.path)).record)


def require_known_robot(
    record: Mapping[str, Any],
    size_m: Sequence[float],
    T_r1_o: Array,
    *,
    weights: str,
    whose: str,
    instead: str,
) -> None:
    """Check that weights were trained on this robot, by its cuboid.

    Raises:
        ConfigError: they were trained on another robot.
    """
    known = record["robot"]
    its = known["size_m"], np.reshape(known["T_r1_o"], (4, 4))
    if not (np.allclose(its[0], size_m) and np.allclose(its[1], T_r1_o)):
        raise ConfigError(
            f"{weights}: knows the robot {known['name']!r}, whose cuboid is {_cuboid(*its)}; that of {whose} "
            f"is {_cuboid(size_m, T_r1_o)}: `rendezvous train-pose` on images of that robot, or {instead}"
        )


def _cuboid(size_m: Sequence[float], T_r1_o: Array) -> str:
    sides, centre = (sep.join(f"{m:g}" for m in of) for sep, of in ((" x ", size_m), (", ", T_r1_o[:3, 3])))
    return f"{sides} m around ({centre}) m"


@cache
def _loaded(weights: PoseWeights, floor: bool) -> ImagePoseEstimator:
    _require_torch()
    import torch

    from rendezvous.stages.weights.trained_estimators import load_relative_pose

    torch.set_num_threads(1)
    return replace(load_relative_pose(_bytes(weights.path), where=str(weights.path)), floor=floor)


def _require_torch() -> None:
    with needs_extra("fuse", "the relative-pose estimator"):
        import torch  # noqa: F401 - whether it is there


def _bytes(path: Path) -> bytes:
    return Disk(str(path.parent)).read(path.name)
