"""Where the time goes: clocks around functions while they are in use."""

from __future__ import annotations

import time
from collections import defaultdict
from collections.abc import Callable, Sequence
from typing import Any

Part = tuple[Any, str, str]
"""An owner (module or class), the name of its function, and the part of the work that this counts to."""


class Clocks:
    """Clocks around the parts while it is open; the innermost one runs."""

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
        """Shares of the elapsed time; the rest is the loop itself."""
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
