"""Progress of a stage: a bar on a terminal, a line every ten seconds elsewhere."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import (
    BarColumn,
    Progress,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)

LINE_EVERY_S = 10.0


@contextmanager
def meter(
    stage: str, *, total: int | None, console: Console, parts: str = "shards", rows: str = "rows"
) -> Iterator[Meter]:
    """The meter of one stage.

    Args:
        stage: its name.
        total: number of shards, None if that is not known beforehand.
        console: where to print.
        parts, rows: what to call shards and rows.
    """
    if not console.is_terminal:
        yield Meter(stage, total, console, parts, rows)
        return
    # 80 columns hold it all.
    columns = (
        TextColumn("[bold]{task.description}"),
        BarColumn(bar_width=14),
        TextColumn("{task.fields[counts]}"),
        TimeElapsedColumn(),
        TextColumn("left"),
        TimeRemainingColumn(compact=True),
    )
    with Progress(*columns, console=console) as progress:
        yield _Bar(stage, total, console, parts, rows, progress)


class Meter:
    """Counts shards and rows, and prints the counts from time to time."""

    def __init__(
        self, stage: str, total: int | None, console: Console, parts_name: str, rows_name: str
    ) -> None:
        self._stage = stage
        self._total = total
        self._console = console
        self._parts_name, self._rows_name = parts_name, rows_name
        self._shards = self._shards_made = self._rows = self._rows_made = 0
        self._started_s = self._last_line_s = time.monotonic()

    def say(self, line: str) -> None:
        """Print a line."""
        self._console.print(line, highlight=False, markup=False, soft_wrap=True)

    def advance(self, rows: int, *, made: bool) -> None:
        """Count one more shard, made now or found finished."""
        self._shards += 1
        self._rows += rows
        self._shards_made += made
        self._rows_made += made * rows
        self._show()

    def _show(self) -> None:
        now_s = time.monotonic()
        if now_s - self._last_line_s >= LINE_EVERY_S:
            self._last_line_s = now_s
            self.say(f"{self._stage}: {self._counts()}{self._left()}")

    def _elapsed_s(self) -> float:
        return time.monotonic() - self._started_s

    def _counts(self) -> str:
        """E.g. `6/48 shards, 48 rows, 3.1/s`."""
        of_total = f"/{self._total}" if self._total is not None else ""
        rate = self._rows_made / max(self._elapsed_s(), 1e-3)
        return f"{self._shards}{of_total} {self._parts_name}, {self._rows} {self._rows_name}, {rate:.1f}/s"

    def _left(self) -> str:
        """E.g. `, about 40 s left`; empty as long as that cannot be known."""
        if self._total is None or not self._shards_made:
            return ""
        return f", about {(self._total - self._shards) * self._elapsed_s() / self._shards_made:.0f} s left"


class _Bar(Meter):
    """Shows the counts in a progress bar, below the lines that are printed."""

    def __init__(
        self,
        stage: str,
        total: int | None,
        console: Console,
        parts_name: str,
        rows_name: str,
        progress: Progress,
    ) -> None:
        super().__init__(stage, total, console, parts_name, rows_name)
        self._progress = progress
        self._task = progress.add_task(stage, total=total, counts=self._counts())

    def _show(self) -> None:
        self._progress.update(self._task, completed=self._shards, counts=self._counts())
