"""Progress of a stage: a bar on a terminal, plain lines elsewhere."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Protocol

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
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

    def advance(self, counts: Mapping[str, int], *, made: bool) -> None:
        """One more shard is there, made now or found finished."""


@contextmanager
def meter(stage: str, *, total: int | None, console: Console) -> Iterator[Meter]:
    """The meter of one stage.

    Args:
        stage: its name.
        total: how many shards there will be, None if that is not known beforehand.
    """
    if not console.is_terminal:
        yield _Lines(stage, total, console)
        return
    columns = (
        TextColumn("[bold]{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("shards  {task.fields[told]}"),
        TimeElapsedColumn(),
        TextColumn("left"),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=console) as progress:
        yield _Bar(stage, total, progress)


class _Tally:
    """Sums and the rate of what is made."""

    def __init__(self) -> None:
        self.started_s = time.monotonic()
        self.shards = 0
        self.shards_made = 0
        self.totals: dict[str, int] = {}
        self.made: dict[str, int] = {}

    def add(self, counts: Mapping[str, int], *, made: bool) -> None:
        self.shards += 1
        self.shards_made += made
        for name, count in counts.items():
            self.totals[name] = self.totals.get(name, 0) + count
            self.made[name] = self.made.get(name, 0) + made * count

    def elapsed_s(self) -> float:
        return time.monotonic() - self.started_s

    def told(self) -> str:
        """E.g. `48 plans (3.1/s), 40 accepted (2.6/s)`."""
        elapsed_s = max(self.elapsed_s(), 1e-3)
        return ", ".join(
            f"{total} {name} ({self.made[name] / elapsed_s:.1f}/s)" for name, total in self.totals.items()
        )


class _Bar:
    def __init__(self, stage: str, total: int | None, progress: Progress) -> None:
        self._progress = progress
        self._task = progress.add_task(stage, total=total, told="")
        self._tally = _Tally()

    def say(self, line: str) -> None:
        self._progress.console.print(line, highlight=False, markup=False)

    def advance(self, counts: Mapping[str, int], *, made: bool) -> None:
        self._tally.add(counts, made=made)
        self._progress.update(self._task, advance=1, told=self._tally.told())


class _Lines:
    def __init__(self, stage: str, total: int | None, console: Console) -> None:
        self._stage, self._total, self._console = stage, total, console
        self._tally = _Tally()
        self._last_line_s = time.monotonic()

    def say(self, line: str) -> None:
        self._console.print(line, highlight=False, markup=False, soft_wrap=True)

    def advance(self, counts: Mapping[str, int], *, made: bool) -> None:
        self._tally.add(counts, made=made)
        now_s = time.monotonic()
        if now_s - self._last_line_s >= LINE_EVERY_S:
            self._last_line_s = now_s
            self.say(f"{self._stage}: {self._shards()}: {self._tally.told()}{self._left()}")

    def _shards(self) -> str:
        of_total = f"/{self._total}" if self._total is not None else ""
        return f"{self._tally.shards}{of_total} shards"

    def _left(self) -> str:
        tally = self._tally
        if self._total is None or not tally.shards_made:
            return ""
        left_s = (self._total - tally.shards) * tally.elapsed_s() / tally.shards_made
        return f", about {left_s:.0f} s left"
