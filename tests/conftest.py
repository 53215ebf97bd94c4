"""What tests of several rooms share."""

from __future__ import annotations

import os
import subprocess
import time
from collections.abc import Callable, Sequence
from functools import cache
from io import StringIO
from pathlib import Path

import pytest
from hypothesis import settings
from rich.console import Console

from rendezvous.config.load import Config, load_config
from rendezvous.engine.pool import Engine
from rendezvous.engine.run import Run

ROOT = Path(__file__).parent.parent

# Hypothesis fails what takes longer than 0.2 s: a call that compiles first, or any on a busy machine. The
# same examples each time: a run says something about the code, not about luck.
settings.register_profile("steady", deadline=None, derandomize=True)
settings.load_profile("steady")

MakeRun = Callable[..., Run]

PATIENCE_S = 900.0
"""How long tests wait for what is sure to happen: no machine is that slow."""


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Put the longest file first, so that no core waits for it in the end."""
    items.sort(key=lambda item: item.path.name != "test_pipeline.py")


def wait_until(happened: Callable[[], bool], process: subprocess.Popen | None = None) -> None:
    """Wait for something to happen while `process`, if given, runs."""
    deadline_s = time.monotonic() + PATIENCE_S
    while not happened():
        assert process is None or process.poll() is None, "the process ended before it happened"
        assert time.monotonic() < deadline_s, f"did not happen within {PATIENCE_S:.0f} s"
        time.sleep(0.005)


@pytest.fixture(scope="session")
def real_data() -> Path:
    """Genuine floor plans and maps, which are not part of the project; skips where they are not."""
    folder = Path(os.environ.get("RENDEZVOUS_TEST_DATA", ROOT / "../shared/data"))
    if not folder.is_dir():
        pytest.skip(f"no real data at {folder}; RENDEZVOUS_TEST_DATA names its folder")
    return folder


@pytest.fixture
def make_run(tmp_path: Path) -> MakeRun:
    """Makes a run of the smoke preset that works in this process; its `console.file` holds what it says."""

    def make(overrides: Sequence[str] = (), *, data: str | None = None, seed: int | None = None) -> Run:
        return run_in(data or str(tmp_path / "data"), overrides, seed=seed)

    return make


@cache
def smoke_config(overrides: tuple[str, ...] = (), seed: int | None = None) -> Config:
    """The smoke preset; many tests ask for the same."""
    return load_config(ROOT / "stages.yaml", preset="smoke", overrides=overrides, seed=seed)


def run_in(data: str, overrides: Sequence[str] = (), *, seed: int | None = None) -> Run:
    """A run of the smoke preset in a folder, in this process."""
    return Run(
        config=smoke_config(tuple(overrides), seed),
        data=data,
        workers=1,
        engine=Engine.INLINE,
        console=Console(file=StringIO(), width=200),
    )
