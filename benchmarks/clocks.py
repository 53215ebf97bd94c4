"""Measure time: clocks around functions while they are used, and calls side by side."""

from __future__ import annotations

import statistics
import time
from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from typing import Any

Part = tuple[Any, str, str]
"""A module or class, the name of a function in it, and the part of the work it belongs to."""


class Clocks:
    """A context in which each part is timed; while one part calls another, only the inner clock runs."""

    def __init__(self, parts: Sequence[Part]) -> None:
        self._parts = parts
        self._total_s: dict[str, float] = defaultdict(float)
        self._running: list[str] = []
        self._since_s = 0.0

    def __enter__(self) -> Clocks:
        self._originals = [(owner, name, getattr(owner, name)) for owner, name, _ in self._parts]
        for (owner, name, part), (_, _, original) in zip(self._parts, self._originals, strict=True):
            setattr(owner, name, self._timed(original, part))
        return self

    def __exit__(self, *_: object) -> None:
        for owner, name, original in self._originals:
            setattr(owner, name, original)

    def shares(self, elapsed_s: float) -> dict[str, float]:
        """Each part's share of the elapsed time; `loop` is the rest."""
        shares = {part: total_s / elapsed_s for part, total_s in self._total_s.items()}
        shares["loop"] = 1.0 - sum(shares.values())
        return {part: round(share, 3) for part, share in sorted(shares.items(), key=lambda item: -item[1])}

    def _timed(self, function: Callable[..., Any], part: str) -> Callable[..., Any]:
        def timed(*args: Any, **kwargs: Any) -> Any:
            self._switch(part)
            try:
                return function(*args, **kwargs)
            finally:
                self._switch(None)

        return timed

    def _switch(self, part: str | None) -> None:
        now_s = time.perf_counter()
        if self._running:
            self._total_s[self._running[-1]] += now_s - self._since_s
        if part is None:
            self._running.pop()
        else:
            self._running.append(part)
        self._since_s = now_s


def side_by_side_s(
    ways: Mapping[str, Callable[[], object]], *, repeats: int, calls: int = 1
) -> dict[str, float]:
    """Median seconds of a call, by name. They take turns, so that other work slows all of them alike."""
    times_s: dict[str, list[float]] = {name: [] for name in ways}
    for _ in range(repeats):
        for name, call in ways.items():
            started_s = time.perf_counter()
            for _ in range(calls):
                call()
            times_s[name].append((time.perf_counter() - started_s) / calls)
    return {name: statistics.median(values) for name, values in times_s.items()}
