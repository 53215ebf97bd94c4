"""Run something over many items, in worker processes or in this one, and never twice over the same."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Generic, Protocol, TypeVar

from rich.console import Console

import rendezvous
from rendezvous.engine.pool import Call, Engine, run_calls
from rendezvous.engine.progress import meter
from rendezvous.store.disk import Disk
from rendezvous.store.records import digest_of, json_bytes

_CODE = Path(rendezvous.__path__[0])
_ITEMS_PER_CALL = 16


class Kept(Protocol):
    """An outcome that a cache can hold."""

    def to_json(self) -> dict[str, Any]:
        """Values as JSON holds them."""


Item = TypeVar("Item")
ItemOut = TypeVar("ItemOut", covariant=True)


class Items(Protocol[ItemOut]):
    """Things that are counted, and read only when their turn comes."""

    def __len__(self) -> int:
        """How many."""

    def __getitem__(self, number: int, /) -> ItemOut:
        """One of them."""


Outcome = TypeVar("Outcome", bound=Kept)


@dataclass(frozen=True, slots=True, kw_only=True)
class Measurement(Generic[Item, Outcome]):
    """What is done with items.

    Attributes:
        command: that does it, for what is told.
        name: of what is measured; a file's name begins with it.
        items_name: what to call the items.
        measure: outcomes of some items, in their order; can be pickled.
        from_json: an outcome of the values that it was kept as.
        key: all that outcomes depend on, as JSON holds it.
        in_this_process: where `measure` uses all cores itself, and cannot be pickled.
    """

    command: str
    name: str
    items_name: str
    measure: Callable[[Sequence[Item]], Sequence[Outcome]]
    from_json: Callable[[Mapping[str, Any]], Outcome]
    key: Mapping[str, Any]
    in_this_process: bool = False


def measured(
    measurement: Measurement[Item, Outcome],
    items: Items[Item],
    *,
    cache: Disk,
    workers: int,
    console: Console,
) -> tuple[Outcome, ...]:
    """What becomes of each item; from the cache, if nothing that it depends on has changed.

    Args:
        measurement: what to do.
        items: at least one.
        cache: folder of what was measured before.
        workers: processes; a single one is this one.
        console: where to tell.
    """
    name = f"{measurement.name}-{cache_key(measurement, workers=workers)[:16]}.json"
    if (kept := _kept(measurement, cache, name)) is not None:
        told = f"{measurement.command} {measurement.name}: {len(kept)} {measurement.items_name}"
        console.print(f"{told}, as measured before", highlight=False)
        return kept
    outcomes = _run(measurement, items, workers, console)
    cache.write(name, json_bytes({"rows": [row.to_json() for row in outcomes]}))
    return outcomes


def cache_key(measurement: Measurement[Item, Outcome], *, workers: int) -> str:
    """Digest of all that outcomes depend on.

    Times are outcomes too, and workers that share cores change them.
    """
    return digest_of({**measurement.key, "workers": workers})


def code_digest(rooms: Iterable[str], files: Iterable[str]) -> str:
    """Of the source of some rooms and of further files, by their paths in the package."""
    sources = {*(_CODE / name for name in files)}
    for room in rooms:
        sources |= {*(_CODE / room).rglob("*.py")}
    return digest_of(
        {str(path.relative_to(_CODE)): path.read_text(encoding="utf-8") for path in sorted(sources)}
    )


def _run(
    measurement: Measurement[Item, Outcome], items: Items[Item], workers: int, console: Console
) -> tuple[Outcome, ...]:
    total = math.ceil(len(items) / _ITEMS_PER_CALL)
    engine = Engine.LOCAL if workers > 1 and not measurement.in_this_process else Engine.INLINE
    found: dict[int, Sequence[Outcome]] = {}
    with meter(
        f"{measurement.command} {measurement.name}",
        total=total,
        console=console,
        parts="batches",
        rows=measurement.items_name,
    ) as progress:
        for first, outcomes in run_calls(
            _calls(measurement.measure, items), engine=engine, workers=min(workers, total)
        ):
            found[first] = outcomes
            progress.advance(len(outcomes), made=True)
    return tuple(row for first in sorted(found) for row in found[first])


def _calls(
    measure: Callable[[Sequence[Item]], Sequence[Outcome]], items: Items[Item]
) -> Iterator[Call[tuple[int, Sequence[Outcome]]]]:
    for first in range(0, len(items), _ITEMS_PER_CALL):
        numbers = range(first, min(first + _ITEMS_PER_CALL, len(items)))
        yield partial(_numbered, measure, first, tuple(items[number] for number in numbers))


def _numbered(
    measure: Callable[[Sequence[Item]], Sequence[Outcome]], first: int, items: Sequence[Item]
) -> tuple[int, Sequence[Outcome]]:
    return first, measure(items)


def _kept(measurement: Measurement[Item, Outcome], cache: Disk, name: str) -> tuple[Outcome, ...] | None:
    if cache.size(name) is None:
        return None
    try:
        return tuple(measurement.from_json(row) for row in json.loads(cache.read(name))["rows"])
    except (ValueError, KeyError, TypeError):
        return None
