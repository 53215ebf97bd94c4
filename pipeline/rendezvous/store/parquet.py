"""Tables as Parquet files."""

from __future__ import annotations

from dataclasses import dataclass

import pyarrow as pa
import pyarrow.parquet as pq


@dataclass(frozen=True, slots=True, kw_only=True)
class Layout:
    """How a stage's tables are stored in Parquet files.

    Attributes:
        item_column: column with the id of each row's item; None if no stage reads item by item.
        identity: columns that an item's digest covers; all by default. Derived columns (GLB) stay out, so
            that a new exporter does not make the stages that follow stale.
        uncompressed: columns whose content is compressed already (PNG, GLB).
        row_group_rows: rows per row group.
    """

    item_column: str | None = None
    identity: tuple[str, ...] | None = None
    uncompressed: tuple[str, ...] = ()
    row_group_rows: int = 1024


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
