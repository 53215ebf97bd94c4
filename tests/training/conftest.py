"""A published dataset to train on, and a model that trains in a moment."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch

from rendezvous.stages.pack import pack
from rendezvous.store.read import StageReader
from rendezvous.training.frame_error.pairs import PairTable, read_pairs
from rendezvous.training.relative_pose.poses import PoseTable, read_poses
from tests.synthetic_dataset import explored, synthetic_run

SHARES = ("pack.validation_fraction=0.1", "pack.test_fraction=0.1")
"""Six of the ten plans are for training."""


@pytest.fixture(autouse=True)
def _one_thread():
    """Threads that wait for each other on a busy machine make a test ten times slower."""
    torch.set_num_threads(1)


@pytest.fixture(scope="session")
def published(tmp_path_factory) -> Path:
    """A data folder with a packed dataset of ten plans."""
    data = tmp_path_factory.mktemp("published")
    explored(data)
    pack(synthetic_run(data, *SHARES))
    return data


@pytest.fixture(scope="session")
def pairs(published: Path) -> PairTable:
    """The training split."""
    return read_pairs(StageReader(str(published / "dataset"), "pack"), "train")


@pytest.fixture(scope="session")
def poses(published: Path) -> PoseTable:
    """The training split of the images of the robot."""
    return read_poses(StageReader(str(published / "dataset"), "pack"), "train")
