"""What cannot be printed is spelt out; nothing that is printed ends a command."""

from __future__ import annotations

import io
import os
import sys
from pathlib import Path

import pytest

from rendezvous.cli.streams import spell_out_what_the_encoding_lacks
from tests.cli.test_cli import generate, rendezvous


@pytest.mark.parametrize(
    ("encoding", "shown"),
    [
        ("ascii", b"1.5 m^2 +-0.1 at 45 deg, \\u6f22 \\udcff"),
        ("latin-1", b"1.5 m\xb2 \xb10.1 at 45\xb0, \\u6f22 \\udcff"),
        ("utf-8", "1.5 m² ±0.1 at 45°, 漢 \\udcff".encode()),
    ],
)
def test_signs_that_an_encoding_lacks_are_spelt_out(
    monkeypatch: pytest.MonkeyPatch, encoding: str, shown: bytes
):
    for name in ("stdout", "stderr"):
        monkeypatch.setattr(sys, name, io.TextIOWrapper(io.BytesIO(), encoding=encoding))
    spell_out_what_the_encoding_lacks()
    for stream in (sys.stdout, sys.stderr):
        stream.write("1.5 m² ±0.1 at 45°, 漢 \udcff")
        stream.flush()
        assert stream.buffer.getvalue() == shown


def test_a_command_prints_to_a_pipe_in_ascii(tmp_path: Path):
    ascii_only = {**os.environ, "PYTHONIOENCODING": "ascii", "LC_ALL": "C"}
    folder = tmp_path / "plän"
    assert rendezvous(*generate(folder, count=1), env=ascii_only).returncode == 0
    shown = rendezvous("verify", str(folder), env=ascii_only)
    assert (shown.returncode, shown.stderr) == (0, "")
    assert shown.stdout.endswith("/floorplans: sound\n")
    assert shown.stdout.isascii()
    assert rendezvous("--help", env=ascii_only).returncode == 0
