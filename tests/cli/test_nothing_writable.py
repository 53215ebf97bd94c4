"""Where nothing can be written to, not even a folder for temporary files."""

from __future__ import annotations

import tempfile
from pathlib import Path

import pytest
from typer.testing import CliRunner

from rendezvous.cli.__main__ import app


def nowhere() -> str:
    raise FileNotFoundError(2, "No usable temporary directory\nfound")


@pytest.fixture
def needs_one(monkeypatch: pytest.MonkeyPatch) -> None:
    """A command that loads a package which looks for such a folder, as Matplotlib does."""
    monkeypatch.setattr("rendezvous.commands.inspect.inspect", lambda *_, **__: tempfile.gettempdir())


def test_a_package_that_needs_one_is_one_line_and_exit_2(needs_one, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(tempfile, "gettempdir", nowhere)
    shown = CliRunner().invoke(app, ["inspect"])
    assert shown.exit_code == 2
    assert shown.stderr == (
        "rendezvous: there is no folder for temporary files, which some packages need; set TMPDIR to one "
        "that can be written to ([Errno 2] No usable temporary directory found)\n"
    )


def test_another_fault_of_the_disk_keeps_its_traceback(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(
        "rendezvous.commands.inspect.inspect", lambda *_, **__: Path("/nowhere/at/all").read_bytes()
    )
    assert isinstance(CliRunner().invoke(app, ["inspect"]).exception, FileNotFoundError)
