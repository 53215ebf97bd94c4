"""Where an estimator of the relative pose comes from: weights that any worker process can load."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any, Protocol

from pipeline.errors import SetupError, StoreError
from pipeline.pose_estimation.relative_pose import ImagePoseEstimator
from pipeline.store.disk import Disk

SHIPPED_POSE_WEIGHTS = Path(__file__).parents[2] / "assets" / "weights" / "relative_pose.safetensors"
TRAINED_POSE_WEIGHTS = Path("runs/relative-pose/weights.safetensors")


class PoseSource(Protocol):
    """What makes an estimator; small to pickle, and equal if what it makes is equal."""

    @property
    def digest(self) -> str:
        """Of the weights."""

    def estimator(self, *, floor: bool) -> ImagePoseEstimator:
        """The estimator, whose robot stands on the camera's floor or anywhere.

        Raises:
            PipelineError: it cannot be made.
        """

    def record(self) -> dict[str, Any]:
        """What the weights tell of their training.

        Raises:
            PipelineError: they cannot be read.
        """


@dataclass(frozen=True, slots=True, kw_only=True)
class PoseWeights:
    """The estimator that `rendezvous train-pose` trained.

    Attributes:
        path: of its weights.
        digest: of that file.
    """

    path: Path
    digest: str

    @staticmethod
    def found(path: Path | None) -> PoseWeights:
        """The weights of a file; by default those in `runs/`, or else the shipped ones.

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
        """The estimator, with one thread."""
        return _loaded(self, floor)

    def record(self) -> dict[str, Any]:
        """What the weights tell of their training."""
        _require_torch()
        from pipeline.training.checkpoint import read_checkpoint

        return dict(read_checkpoint(_bytes(self.path), where=str(self.path)).record)


@cache
def _loaded(weights: PoseWeights, floor: bool) -> ImagePoseEstimator:
    _require_torch()
    import torch

    from pipeline.stages.pose_weights import load_relative_pose

    torch.set_num_threads(1)
    return replace(load_relative_pose(_bytes(weights.path), where=str(weights.path)), floor=floor)


def _require_torch() -> None:
    try:
        import torch  # noqa: F401 - whether it is there
    except ModuleNotFoundError as error:
        raise SetupError(
            f"the relative-pose estimator needs {error.name}, which is not installed; "
            "`pip install 'rendezvous-fusion[learn]'` installs it"
        ) from error


def _bytes(path: Path) -> bytes:
    return Disk(str(path.parent)).read(path.name)
