"""Pick rows out of a dataset's shards."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
import pyarrow as pa

from rendezvous.geometry.se2 import Array
from rendezvous.schema import TableSchema
from rendezvous.store.read import StageReader

SHARD, ROW = "__shard", "__row"


def located_columns(reader: StageReader, columns: Sequence[str], *, under: str = "") -> pa.Table:
    """Some columns of all shards, or of those `under` a folder, and each row's place: its shard and row."""
    tables = []
    for shard in reader.shards(under):
        table = reader.table(shard.name, columns=list(columns))
        table = table.append_column(SHARD, pa.array([shard.name] * table.num_rows, pa.string()))
        tables.append(table.append_column(ROW, pa.array(range(table.num_rows), pa.int64())))
    return pa.concat_tables(tables)


def rows_at(reader: StageReader, places: pa.Table, schema: TableSchema) -> list[dict[str, Any]]:
    """Whole rows at the places that `located_columns` gave, in the form of the schema's `rows`."""
    wanted = list(zip(places[SHARD].to_pylist(), places[ROW].to_pylist(), strict=True))
    found: dict[tuple[str, int], dict[str, Any]] = {}
    for shard in sorted({name for name, _ in wanted}):
        indices = [row for name, row in wanted if name == shard]
        rows = schema.rows(reader.table(shard).take(indices))
        found |= zip([(shard, i) for i in indices], rows, strict=True)
    return [found[place] for place in wanted]


def evenly_by(values: Array | Iterable[float], count: int) -> list[int]:
    """Indices of `count` values, or of all if there are fewer, at even ranks from low to high."""
    order = np.argsort(np.asarray(values), kind="stable")
    ranks = (np.arange(min(count, len(order))) + 0.5) / min(count, len(order)) * len(order)
    return [int(order[int(rank)]) for rank in ranks]
