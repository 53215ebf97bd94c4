"""Tables as Parquet files, and digests of their content, whatever version of pyarrow wrote it."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq


@dataclass(frozen=True, slots=True, kw_only=True)
class Layout:
    """How a stage's tables are stored in Parquet files."""

    item_column: str | None = None  # with the id of each row's item; None if no stage reads item by item
    # Columns that an item's digest covers; all by default. Derived columns (GLB) stay out, so that a new
    # exporter does not make the stages that follow stale.
    identity: tuple[str, ...] | None = None
    uncompressed: tuple[str, ...] = ()  # columns whose content is compressed already (PNG, GLB)
    row_group_rows: int = 1024  # rows per row group


def parquet_bytes(table: pa.Table, layout: Layout) -> pa.Buffer:
    """The table as a Parquet file; equal tables give equal bytes with one version of pyarrow."""
    leaves = _leaf_columns(table.schema)
    raw = {leaf for leaf in leaves if leaf.split(".")[0] in layout.uncompressed}
    sink = pa.BufferOutputStream()
    pq.write_table(
        table.combine_chunks(),
        sink,
        row_group_size=layout.row_group_rows,
        compression={leaf: "none" if leaf in raw else "zstd" for leaf in leaves},
        use_dictionary=[leaf for leaf in leaves if leaf not in raw],
        write_page_index=True,
        use_content_defined_chunking=True,
    )
    return sink.getvalue()


def _leaf_columns(schema: pa.Schema) -> list[str]:
    """Parquet's names of the leaf columns, such as `map_0.bytes`; options go by leaf."""
    sink = pa.BufferOutputStream()
    pq.write_table(schema.empty_table(), sink)
    parquet_schema = pq.ParquetFile(pa.BufferReader(sink.getvalue())).schema
    return [parquet_schema.column(index).path for index in range(len(parquet_schema))]


def content_digest(table: pa.Table, *, columns: Sequence[str] | None = None) -> str:
    """SHA-256 of column names, types, nulls and values; chunks, encodings and metadata do not count."""
    h = hashlib.sha256()
    for name in sorted(columns if columns is not None else table.column_names):
        h.update(f"column {name!r}\n".encode())
        _feed(h, table.column(name).combine_chunks())
    return h.hexdigest()


def item_digests(
    table: pa.Table, item_column: str, *, columns: Sequence[str] | None = None
) -> dict[str, str]:
    """SHA-256 of each item's rows, by the item's id, in order of appearance."""
    # pyarrow 26 takes wrong values of nested fixed-size lists from a table in chunks.
    table = table.combine_chunks()
    ids = table.column(item_column)
    return {
        item_id: content_digest(table.filter(pc.equal(ids, item_id)), columns=columns)
        for item_id in dict.fromkeys(ids.to_pylist())
    }


def column_types(schema: pa.Schema) -> dict[str, str]:
    """The type of each column, written so that Parquet's round trip does not change it."""
    return {field.name: _type_name(field.type) for field in schema}


def _type_name(kind: pa.DataType) -> str:
    """`_kind` and its elements: `list<struct<t_s: double, x_m: double>>`."""
    if pa.types.is_struct(kind):
        return f"struct<{', '.join(f'{field.name}: {_type_name(field.type)}' for field in kind)}>"
    if _is_list(kind) or pa.types.is_fixed_size_list(kind):
        return f"{_kind(kind)}<{_type_name(kind.value_type)}>"
    return _kind(kind)


def _feed(h: Any, array: pa.Array) -> None:
    kind = array.type
    h.update(f"{_kind(kind)} {len(array)} {array.null_count}\n".encode())
    if array.null_count:
        h.update(np.packbits(array.is_valid().to_numpy(zero_copy_only=False)).tobytes())
    if pa.types.is_struct(kind):
        for index, child in enumerate(array.flatten()):
            h.update(f"field {kind.field(index).name!r}\n".encode())
            _feed(h, child)
    elif _is_list(kind):
        h.update(_little_endian(array.value_lengths().fill_null(0).cast(pa.int64())))
        _feed(h, array.flatten())
    elif pa.types.is_fixed_size_list(kind):
        _feed(h, array.flatten())
    elif _is_bytes(kind):
        h.update(_little_endian(pc.binary_length(array).fill_null(0).cast(pa.int64())))
        for value in array.drop_null():
            h.update(value.as_buffer())
    elif pa.types.is_null(kind):
        return
    elif pa.types.is_boolean(kind):
        h.update(_little_endian(array.fill_null(False).cast(pa.uint8())))
    elif pa.types.is_temporal(kind):
        _feed(h, array.cast(pa.int64() if kind.bit_width == 64 else pa.int32()))
    else:
        h.update(_little_endian(array.fill_null(0)))


def _kind(kind: pa.DataType) -> str:
    """A type without what Parquet's round trip changes: names of list elements, large offsets."""
    if pa.types.is_struct(kind):
        return "struct"
    if _is_list(kind):
        return "list"
    if pa.types.is_fixed_size_list(kind):
        return f"list[{kind.list_size}]"
    if _is_bytes(kind):
        return "string" if pa.types.is_string(kind) or pa.types.is_large_string(kind) else "binary"
    return str(kind)


def _is_list(kind: pa.DataType) -> bool:
    return bool(pa.types.is_list(kind) or pa.types.is_large_list(kind))


def _is_bytes(kind: pa.DataType) -> bool:
    checks = (pa.types.is_string, pa.types.is_large_string, pa.types.is_binary, pa.types.is_large_binary)
    return any(check(kind) for check in checks)


def _little_endian(array: pa.Array) -> bytes:
    values = array.to_numpy(zero_copy_only=False)
    return bytes(values.astype(values.dtype.newbyteorder("<")).tobytes())
