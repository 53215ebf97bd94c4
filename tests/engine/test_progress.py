"""What a stage shows while it runs."""

from __future__ import annotations

import io
import time

import pytest
from rich.console import Console

from rendezvous.engine import progress
from rendezvous.engine.progress import meter


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """The time that passes: its last entry."""
    now_s = [100.0]
    monkeypatch.setattr(time, "monotonic", lambda: now_s[-1])
    return now_s


def test_where_there_is_no_terminal_a_line_comes_now_and_then(clock: list[float]):
    console = Console(file=io.StringIO(), width=200)
    with meter("explore", total=10, console=console) as report:
        report.advance(5, made=False)
        for _ in range(4):
            clock.append(clock[-1] + progress.LINE_EVERY_S / 2)
            report.advance(3, made=True)
    lines = console.file.getvalue().splitlines()
    assert lines == [
        "explore: 3/10 shards, 11 rows, 0.6/s, about 35 s left",
        "explore: 5/10 shards, 17 rows, 0.6/s, about 25 s left",
    ]


def test_without_a_total_there_is_no_guess_of_what_is_left(clock: list[float]):
    console = Console(file=io.StringIO(), width=200)
    with meter("floorplans", total=None, console=console) as report:
        clock.append(clock[-1] + progress.LINE_EVERY_S)
        report.advance(8, made=True)
    assert console.file.getvalue() == "floorplans: 1 shards, 8 rows, 0.8/s\n"


def test_the_bar_fits_a_terminal_of_80_columns():
    console = Console(file=io.StringIO(), width=80, force_terminal=True, color_system=None)
    with meter("floorplans", total=9999, console=console) as report:
        report.advance(100_000, made=False)
        report.say("a line beside it")
    shown = console.file.getvalue()
    assert "a line beside it" in shown
    assert "1/9999 shards, 100000 rows, 0.0/s" in shown
    assert "…" not in shown
