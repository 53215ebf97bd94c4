"""What tests of several stages share."""

from __future__ import annotations

from pathlib import Path

import pytest

from rendezvous.stages.pack import pack
from tests.synthetic_dataset import explored, synthetic_run


@pytest.fixture(scope="session")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A data folder with a published dataset, most of it to train on; tests only read it."""
    folder = tmp_path_factory.mktemp("published")
    explored(folder)
    pack(synthetic_run(folder, "pack.validation_fraction=0.1", "pack.test_fraction=0.1"))
    return folder
