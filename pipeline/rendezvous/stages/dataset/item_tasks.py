"""Tasks of a stage that makes one shard of each batch of items."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from functools import partial
from typing import Any

from rendezvous.engine.run import Task, part_name
from rendezvous.schema import TableSchema
from rendezvous.store.read import Item
from rendezvous.store.records import Inputs, Shard
from rendezvous.store.tables import column_types


def item_tasks(
    batches: Iterable[tuple[Item, ...]],
    make: Callable[[tuple[Item, ...]], Shard],
    *,
    table: TableSchema,
    parameters: Mapping[str, Any],
    seed: int,
    version: int,
    under: str = "",
) -> Iterator[Task]:
    """One task for each batch."""
    for index, batch in enumerate(batches):
        inputs = Inputs(
            parameters=parameters,
            columns=column_types(table.arrow()),
            items={item.item_id: item.digest for item in batch},
            seed=seed,
            version=version,
        )
        yield Task(name=f"{under}{part_name(index)}", inputs=inputs, make=partial(make, batch))
