"""Rows of one split, read straight from the published shards."""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np
import pyarrow as pa

from rendezvous.errors import StoreError
from rendezvous.geometry.se2 import Array
from rendezvous.store.read import StageReader
from rendezvous.store.tables import content_digest

SPLIT_NAMES = ("train", "validation", "test")


class PublishedRows:
    """The rows of one split; compressed columns stay so until they are needed."""

    def __init__(self, split: str, table: pa.Table) -> None:
        self.split, self.table = split, table

    def __len__(self) -> int:
        return int(self.table.num_rows)

    def digest(self) -> str:
        """Digest of the content, independent of how it is stored."""
        return content_digest(self.table)

    def plan_digests(self) -> list[str]:
        """Digests of the rows' floor plans, sorted."""
        return sorted(self.table["plan_digest"].unique().to_pylist())

    def seeds(self) -> list[int]:
        """The root seeds that the rows were made with, sorted."""
        return sorted(self.table["seed"].unique().to_pylist())


def read_split(
    reader: StageReader, kind: str, split: str, *, columns: Sequence[str], finite: Sequence[str] = ()
) -> list[pa.Table]:
    """These columns, in this order, of each file of a split.

    Args:
        reader: of the published dataset.
        kind: the table, such as `pairs`.
        split: one of `SPLIT_NAMES`.
        columns: to read.
        finite: those of them whose numbers are all finite.

    Raises:
        StoreError: the folder holds no such rows, or a file is missing or damaged, lacks a column, or holds a
            number that is not finite.
    """
    names = [shard.name for shard in reader.shards()]
    splits = {name: its_split for name in names if (its_split := _split_of(name, kind))}
    tables = [
        _with_finite(
            reader.table(name, columns=columns).select(list(columns)), finite, f"{reader.root}/{name}"
        )
        for name, its in splits.items()
        if its == split
    ]
    if sum(table.num_rows for table in tables) == 0:
        have = ", ".join(sorted(set(splits.values()))) or f"{len(names)} files without a split in their names"
        raise StoreError(
            f"{reader.root}: no {kind} in {kind}/{split}-*.parquet, found {have}; "
            f"must be a dataset with the splits that `rendezvous pack` writes"
        )
    return tables


def _with_finite(table: pa.Table, finite: Sequence[str], where: str) -> pa.Table:
    for name in finite:
        for chunk in table[name].chunks:
            values = chunk
            while isinstance(values, pa.FixedSizeListArray):
                values = values.flatten()
            if values.null_count or not np.isfinite(values.to_numpy(zero_copy_only=False)).all():
                raise StoreError(
                    f"{where}: column {name} holds a number that is missing or not finite; `rendezvous pack` "
                    "makes the file again"
                )
    return table


def rows_per_split(reader: StageReader, kind: str) -> dict[str, int]:
    """Number of rows in each split of the published dataset, according to its manifest."""
    counts = dict.fromkeys(SPLIT_NAMES, 0)
    for shard in reader.shards():
        if split := _split_of(shard.name, kind):
            counts[split] += shard.rows
    return counts


def number_rows(column: pa.ChunkedArray, *, width: int) -> Array:
    """(N, width) of a column of fixed-size lists without nulls."""
    flat = pa.concat_arrays(column.chunks).flatten()
    return np.asarray(flat.to_numpy(), dtype=np.float64).reshape(-1, width)


def _split_of(name: str, kind: str) -> str | None:
    """The split of a file; None if the file is not of this kind."""
    found = re.fullmatch(rf"{kind}/({'|'.join(SPLIT_NAMES)})-[0-9]+-of-[0-9]+\.parquet", name)
    return found[1] if found else None
