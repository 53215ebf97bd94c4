"""Read a stage's finished output."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import groupby
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from rendezvous.errors import StoreError
from rendezvous.store.disk import Disk
from rendezvous.store.records import MANIFEST, Manifest, ShardRecord


@dataclass(frozen=True, slots=True, kw_only=True)
class Item:
    """An item of a stage's output: its id, the digest of its rows, and their shard."""

    item_id: str
    digest: str
    shard: str


@dataclass(frozen=True, slots=True)
class StageReader:
    """One stage's output. It is small to pickle: workers read what their shards need."""

    root: str
    stage: str | None = None  # names the command that makes it, for messages

    def manifest(self) -> Manifest:
        """The stage's manifest.

        Raises:
            StoreError: there is none, because the stage has not finished.
        """
        manifest = read_manifest(Disk(self.root))
        if manifest is None:
            remedy = f"; run `rendezvous {self.stage}` first" if self.stage else ""
            raise StoreError(f"{self.root}: no {MANIFEST}, so the stage has not finished{remedy}")
        return manifest

    def shards(self, under: str = "") -> tuple[ShardRecord, ...]:
        """The stage's shards, or those of one table, such as `pairs/`."""
        return tuple(shard for shard in self.manifest().shards if shard.name.startswith(under))

    def items(self, under: str = "") -> Iterator[Item]:
        """The items of these shards, in order."""
        for shard in self.shards(under):
            for item_id, digest in shard.items.items():
                yield Item(item_id=item_id, digest=digest, shard=shard.name)

    def table(self, shard: str, *, columns: Sequence[str] | None = None) -> pa.Table:
        """One shard's rows.

        Raises:
            StoreError: the shard is missing or damaged, or lacks one of the columns.
        """
        disk = Disk(self.root)
        again = f"{f'`rendezvous {self.stage}`' if self.stage else 'its stage'} makes it again"
        try:
            with disk.filesystem.open_input_file(disk.path(shard)) as source:
                file = pq.ParquetFile(source)
                missing = [name for name in columns or () if name not in file.schema_arrow.names]
                if not missing:
                    # In one piece: pyarrow 26 takes wrong values of chunked nested fixed-size lists.
                    return file.read(columns=columns).combine_chunks()
        except (OSError, pa.ArrowInvalid) as error:
            raise StoreError(
                f"{disk.shown(shard)}: cannot be read ({' '.join(str(error).split())}); {again}"
            ) from error
        table = shard.split("/")[0] if "/" in shard else self.stage
        raise StoreError(f"{disk.shown(shard)}: table {table} has no column {missing[0]!r}; {again}")

    def rows(
        self,
        items: Iterable[Item] | None = None,
        *,
        item_column: str = "plan_id",
        columns: Sequence[str] | None = None,
    ) -> Iterator[dict[str, Any]]:
        """Rows as dictionaries, one shard in memory at a time.

        Those of `items`, in this order, or all.
        """
        if items is None:
            for shard in self.shards():
                yield from self.table(shard.name, columns=columns).to_pylist()
            return
        wanted_columns = None if columns is None else list(dict.fromkeys([item_column, *columns]))
        for shard_name, group in groupby(items, key=lambda item: item.shard):
            table = self.table(shard_name, columns=wanted_columns)
            ids = table.column(item_column).to_pylist()
            kept = table if columns is None else table.select(list(columns))
            for item in group:
                indices = [row for row, item_id in enumerate(ids) if item_id == item.item_id]
                yield from kept.take(indices).to_pylist()


def chunks(items: Iterable[Item], size: int) -> Iterator[tuple[Item, ...]]:
    """Items in groups of at most `size`, none of which spans two upstream shards.

    New items at the end therefore add groups and leave the earlier groups as they were.
    """
    for _, group in groupby(items, key=lambda item: item.shard):
        of_one_shard = list(group)
        for start in range(0, len(of_one_shard), size):
            yield tuple(of_one_shard[start : start + size])


def read_manifest(disk: Disk) -> Manifest | None:
    """A folder's manifest; None if it has none.

    Raises:
        StoreError: the manifest is damaged.
    """
    fields = read_json(disk, MANIFEST)
    if fields is None:
        return None
    try:
        return Manifest.from_json(fields)
    except (AttributeError, KeyError, TypeError) as error:
        raise StoreError(f"{disk.shown(MANIFEST)}: damaged ({error}); run the stage again") from error


def read_record(disk: Disk, shard_name: str) -> ShardRecord | None:
    """The record of a finished shard; None if it is missing or cannot be read."""
    try:
        fields = read_json(disk, ShardRecord.record_name(shard_name))
        return None if fields is None else ShardRecord.from_json(fields)
    except (AttributeError, KeyError, TypeError, StoreError):
        return None


def read_json(disk: Disk, name: str) -> dict[str, Any] | None:
    """Content of a JSON file; None if there is none."""
    if disk.size(name) is None:
        return None
    try:
        return dict(json.loads(disk.read(name)))
    except (TypeError, ValueError) as error:  # another kind of value than an object, or not JSON
        raise StoreError(f"{disk.shown(name)}: damaged ({error}); run the stage again") from error
