"""Measure many items, in worker processes or in this one, and keep the outcomes for the next run."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache, partial
from pathlib import Path
from typing import Any, Generic, Protocol, TypeVar

from rich.console import Console

import rendezvous
from rendezvous.engine.pool import Call, Engine, run_calls
from rendezvous.engine.progress import meter
from rendezvous.errors import ConfigError
from rendezvous.evaluation.json_record import JsonRecord
from rendezvous.stages.weights.provenance import versions
from rendezvous.store.disk import Disk
from rendezvous.store.records import digest_of, json_bytes
from rendezvous.training.frame_error.pairs import SPLIT_NAMES

_CODE = Path(rendezvous.__path__[0])
_PACKAGES = ("numpy", "scipy", "opencv-python-headless", "numba", "torch")
_ITEMS_PER_CALL = 16


Item = TypeVar("Item")
ItemOut = TypeVar("ItemOut", covariant=True)


class Items(Protocol[ItemOut]):
    """A sequence whose items are read when they are needed."""

    def __len__(self) -> int:
        """Number of items."""

    def __getitem__(self, number: int, /) -> ItemOut:
        """One item."""


Outcome = TypeVar("Outcome", bound=JsonRecord)


@dataclass(frozen=True, slots=True, kw_only=True)
class EvaluationSettings:
    """What all evaluations ask for."""

    dataset: str = "data/dataset"  # folder that `pack` wrote
    split: str = "test"  # of it
    seed: int = 0  # of everything that is drawn
    folder: Path = Path("report")  # of the report
    workers: int = 1  # number of processes; 1 means this one
    console: Console = field(default_factory=lambda: Console(stderr=True))  # for progress and messages

    def require_split(self) -> None:
        """Check that there is such a split.

        Raises:
            ConfigError: there is none.
        """
        if self.split not in SPLIT_NAMES:
            raise ConfigError(f"--split is {self.split!r}; must be one of {', '.join(SPLIT_NAMES)}")

    def warn_of_known_plans(self, name: str, known: int | None, plans: int) -> None:
        """Print that weights were trained on some of the measured floor plans, if they were."""
        if known:
            self.console.print(
                f"evaluate {name}: warning: trained on {known} of these {plans} floor plans; its errors on "
                "plans that it never saw may be larger than these",
                highlight=False,
                soft_wrap=True,
            )


@dataclass(frozen=True, slots=True, kw_only=True)
class Measurement(Generic[Item, Outcome]):
    """How items are measured."""

    command: str  # the user's, for messages
    cache: str  # name of the folder of kept outcomes in that of the report
    name: str  # what is measured; the cache file's name begins with it
    items_name: str  # plural noun for the items
    measure: Callable[[Sequence[Item]], Sequence[Outcome]]  # outcomes of some items, in order; can be pickled
    outcome: type[Outcome]
    # Everything that outcomes depend on beside code and packages, as JSON values; empty if that is not known:
    # then outcomes are not kept.
    key: Mapping[str, Any]
    in_this_process: bool = False  # `measure` uses all cores itself, or cannot be pickled


def measured(
    measurement: Measurement[Item, Outcome],
    items: Items[Item],
    settings: EvaluationSettings,
) -> tuple[Outcome, ...]:
    """The outcome of each of at least one item, from the cache if nothing that it depends on has changed."""
    workers, console = settings.workers, settings.console
    if not measurement.key:
        return _run(measurement, items, workers, console)
    cache = Disk(str(settings.folder / measurement.cache))
    name = f"{measurement.name}-{cache_key(measurement, workers=workers)[:16]}.json"
    if (kept := _kept(measurement, cache, name)) is not None:
        found = f"{measurement.command} {measurement.name}: {len(kept)} {measurement.items_name}"
        console.print(f"{found}, as measured before", highlight=False)
        return kept
    outcomes = _run(measurement, items, workers, console)
    cache.write(name, json_bytes({"rows": [row.to_json() for row in outcomes]}))
    return outcomes


def cache_key(measurement: Measurement[Item, Outcome], *, workers: int) -> str:
    """Digest of everything that outcomes depend on.

    Any change of the code makes a new one. Times are outcomes too, and workers that share cores change them.
    """
    return digest_of({**measurement.key, **_code_and_packages(), "workers": workers})


@cache
def _code_and_packages() -> dict[str, Any]:
    """Digest of all of this package's code, and versions of what it computes with."""
    sources = {str(path.relative_to(_CODE)): path.read_bytes() for path in sorted(_CODE.rglob("*.py"))}
    digests = {name: hashlib.sha256(source).hexdigest() for name, source in sources.items()}
    return {"code": digest_of(digests), "packages": versions(_PACKAGES)}


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
        return tuple(measurement.outcome.from_json(row) for row in json.loads(cache.read(name))["rows"])
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError):
        return None
