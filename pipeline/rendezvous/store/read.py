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
from rendezvous.store.json_types import require_types
from rendezvous.store.records import MANIFEST, Manifest, ShardRecord
from rendezvous.store.tables import column_types

_NO_RECORD = (AttributeError, KeyError, TypeError, ValueError, RecursionError)
"""Raised where JSON holds something else than a record or a manifest."""


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
            StoreError: the shard is missing or damaged, lacks one of the columns, or has one of another type
                than its record says.
        """
        disk = Disk(self.root)
        again = f"{f'`rendezvous {self.stage}`' if self.stage else 'its stage'} makes it again"
        table_name = shard.split("/")[0] if "/" in shard else self.stage
        record = read_record(disk, shard)
        try:
            with disk.filesystem.open_input_file(disk.path(shard)) as source:
                file = pq.ParquetFile(source)
                types = column_types(file.schema_arrow)
                wanted = list(file.schema_arrow.names if columns is None else columns)
                for name in wanted:
                    if name not in types:
                        raise StoreError(
                            f"{disk.shown(shard)}: table {table_name} has no column {name!r}; {again}"
                        )
                    right = (record.inputs.columns if record else {}).get(name, types[name])
                    if types[name] != right:
                        raise StoreError(
                            f"{disk.shown(shard)}: column {name!r} of table {table_name} is {types[name]}; "
                            f"must be {right}; {again}"
                        )
                # In one piece: pyarrow 26 takes wrong values of chunked nested fixed-size lists.
                table = file.read(columns=columns).combine_chunks()
            table.validate(full=True)
        except (OSError, pa.ArrowException, UnicodeError) as error:
            raise StoreError(
                f"{disk.shown(shard)}: cannot be read ({' '.join(str(error).split())}); {again}"
            ) from error
        return table

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
    except _NO_RECORD as error:
        raise StoreError(f"{disk.shown(MANIFEST)}: damaged ({error}); run the stage again") from error


def read_record(disk: Disk, shard_name: str) -> ShardRecord | None:
    """The record of a finished shard; None if it is missing, cannot be read, or is another shard's."""
    try:
        fields = read_json(disk, ShardRecord.record_name(shard_name))
        record = None if fields is None else ShardRecord.from_json(fields)
    except (*_NO_RECORD, StoreError):
        return None
    return record if record is not None and record.name == shard_name else None


def read_json(disk: Disk, name: str) -> dict[str, Any] | None:
    """Content of a JSON file; None if there is none."""
    if disk.size(name) is None:
        return None
    try:
        fields = json.loads(disk.read(name), parse_constant=_no_number)
        require_types(fields)
    except (TypeError, ValueError, RecursionError) as error:  # another kind of value, or not JSON
        raise StoreError(f"{disk.shown(name)}: damaged ({error}); run the stage again") from error
    return dict(fields)


def _no_number(name: str) -> float:
    raise ValueError(f"holds {name}")
