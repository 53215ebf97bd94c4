"""Progress of a stage: a bar on a terminal, plain lines elsewhere."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Protocol

from rich.console import Console
from rich.progress import (
    BarColumn,
    Progress,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)

LINE_EVERY_S = 10.0


class Meter(Protocol):
    """What a stage reports to while it runs."""

    def say(self, line: str) -> None:
        """Print a line."""

    def advance(self, rows: int, *, made: bool) -> None:
        """One more shard is there, of so many rows, made now or found finished."""


@contextmanager
def meter(
    stage: str, *, total: int | None, console: Console, parts: str = "shards", rows: str = "rows"
) -> Iterator[Meter]:
    """The meter of one stage.

    Args:
        stage: its name.
        total: how many shards there will be, None if that is not known beforehand.
        console: where to print.
        parts, rows: what to call shards and rows.
    """
    tally = _Tally(stage, total, parts, rows)
    if not console.is_terminal:
        yield _Lines(tally, console)
        return
    # 80 columns hold it all.
    columns = (
        TextColumn("[bold]{task.description}"),
        BarColumn(bar_width=14),
        TextColumn("{task.fields[told]}"),
        TimeElapsedColumn(),
        TextColumn("left"),
        TimeRemainingColumn(compact=True),
    )
    with Progress(*columns, console=console) as progress:
        yield _Bar(tally, progress)


class _Tally:
    """What is there, and how fast it comes."""

    def __init__(self, stage: str, total: int | None, parts_name: str, rows_name: str) -> None:
        self.stage = stage
        self.total = total
        self._parts_name, self._rows_name = parts_name, rows_name
        self.shards = self.shards_made = self.rows = self.rows_made = 0
        self._started_s = time.monotonic()

    def add(self, rows: int, *, made: bool) -> None:
        self.shards += 1
        self.rows += rows
        self.shards_made += made
        self.rows_made += made * rows

    def elapsed_s(self) -> float:
        return time.monotonic() - self._started_s

    def told(self) -> str:
        """E.g. `6/48 shards, 48 rows, 3.1/s`."""
        of_total = f"/{self.total}" if self.total is not None else ""
        rate = self.rows_made / max(self.elapsed_s(), 1e-3)
        return f"{self.shards}{of_total} {self._parts_name}, {self.rows} {self._rows_name}, {rate:.1f}/s"

    def left(self) -> str:
        """E.g. `, about 40 s left`, once that can be known."""
        if self.total is None or not self.shards_made:
            return ""
        return f", about {(self.total - self.shards) * self.elapsed_s() / self.shards_made:.0f} s left"


class _Bar:
    def __init__(self, tally: _Tally, progress: Progress) -> None:
        self._tally = tally
        self._progress = progress
        self._task = progress.add_task(tally.stage, total=tally.total, told=tally.told())

    def say(self, line: str) -> None:
        self._progress.console.print(line, highlight=False, markup=False, soft_wrap=True)

    def advance(self, rows: int, *, made: bool) -> None:
        self._tally.add(rows, made=made)
        self._progress.update(self._task, advance=1, told=self._tally.told())


class _Lines:
    def __init__(self, tally: _Tally, console: Console) -> None:
        self._tally = tally
        self._console = console
        self._last_line_s = time.monotonic()

    def say(self, line: str) -> None:
        self._console.print(line, highlight=False, markup=False, soft_wrap=True)

    def advance(self, rows: int, *, made: bool) -> None:
        self._tally.add(rows, made=made)
        now_s = time.monotonic()
        if now_s - self._last_line_s >= LINE_EVERY_S:
            self._last_line_s = now_s
            self.say(f"{self._tally.stage}: {self._tally.told()}{self._tally.left()}")
