"""Digests of what a table says."""

from __future__ import annotations

import hashlib
import io
import struct

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from rendezvous.store.tables import Layout, column_types, content_digest, item_digests, parquet_bytes

IMAGE = pa.struct([("bytes", pa.binary()), ("path", pa.string())])
SCHEMA = pa.schema(
    [
        ("name", pa.string()),
        ("count", pa.int32()),
        ("value", pa.float64()),
        ("flag", pa.bool_()),
        ("pose", pa.list_(pa.float64(), 3)),
        ("path", pa.list_(pa.struct([("t_s", pa.float64()), ("x_m", pa.float64())]))),
        ("rings", pa.list_(pa.list_(pa.list_(pa.float64(), 2)))),
        ("image", IMAGE),
        ("when", pa.timestamp("us")),
    ]
)
ROWS = [
    {
        "name": "a",
        "count": 1,
        "value": 0.5,
        "flag": True,
        "pose": [1.0, 2.0, 3.0],
        "path": [{"t_s": 0.0, "x_m": 1.0}, {"t_s": 1.0, "x_m": None}],
        "rings": [[[0.0, 0.0], [1.0, 0.0]], []],
        "image": {"bytes": b"\x00\x01", "path": None},
        "when": 7,
    },
    {
        "name": None,
        "count": None,
        "value": None,
        "flag": None,
        "pose": None,
        "path": None,
        "rings": None,
        "image": None,
        "when": None,
    },
    {
        "name": "",
        "count": 0,
        "value": 0.0,
        "flag": False,
        "pose": [0.0, 0.0, 0.0],
        "path": [],
        "rings": [],
        "image": {"bytes": b"", "path": ""},
        "when": 0,
    },
]


def table_of(rows: list[dict]) -> pa.Table:
    return pa.Table.from_pylist(rows, schema=SCHEMA)


def test_the_digest_is_what_its_definition_says():
    table = pa.table({"x": pa.array([1.0, None]), "s": pa.array(["ab", "c"])})
    strings = b"column 's'\nstring 2 0\n" + struct.pack("<2q", 2, 1) + b"abc"
    numbers = b"column 'x'\ndouble 2 1\n" + bytes([0b10000000]) + struct.pack("<2d", 1.0, 0.0)
    assert content_digest(table) == hashlib.sha256(strings + numbers).hexdigest()


def test_chunks_slices_and_metadata_do_not_count():
    table = table_of(ROWS)
    chunked = pa.concat_tables([table.slice(0, 1), table.slice(1, 2)])
    sliced = pa.concat_tables([table_of(ROWS[2:]), table]).slice(1)
    marked = table.replace_schema_metadata({"k": "v"})
    large = table.set_column(0, "name", table["name"].cast(pa.large_string()))
    assert {content_digest(t) for t in (table, chunked, sliced, marked, large)} == {content_digest(table)}


@pytest.mark.parametrize("compression", ["none", "zstd"])
def test_parquet_does_not_change_it(compression: str):
    table, file = table_of(ROWS), io.BytesIO()
    pq.write_table(table, file, compression=compression)
    assert content_digest(pq.read_table(file)) == content_digest(table)


def edits() -> list[tuple[str, int, object]]:
    return [
        ("name", 0, "b"),
        ("name", 1, ""),
        ("name", 2, None),
        ("count", 0, 2),
        ("count", 1, 0),
        ("value", 0, float(np.nextafter(0.5, 1.0))),
        ("value", 1, 0.0),
        ("flag", 0, False),
        ("flag", 1, False),
        ("pose", 0, [1.0, 2.0, 4.0]),
        ("pose", 1, [0.0, 0.0, 0.0]),
        ("path", 0, [{"t_s": 0.0, "x_m": 1.0}, {"t_s": 1.0, "x_m": 0.0}]),
        ("path", 0, [{"t_s": 0.0, "x_m": 1.0}, None]),
        ("path", 1, []),
        ("rings", 0, [[[0.0, 0.0]], [[1.0, 0.0]]]),
        ("rings", 2, [[]]),
        ("image", 0, {"bytes": b"\x00\x02", "path": None}),
        ("image", 0, {"bytes": b"\x00\x01", "path": ""}),
        ("image", 1, {"bytes": None, "path": None}),
        ("when", 0, 8),
    ]


@pytest.mark.parametrize(("column", "row", "value"), edits())
def test_every_change_of_a_value_changes_it(column: str, row: int, value: object):
    rows = [dict(r) for r in ROWS]
    rows[row][column] = value
    assert content_digest(table_of(rows)) != content_digest(table_of(ROWS))


def test_names_kinds_and_borders_between_values_count():
    def digest(**columns: pa.Array) -> str:
        return content_digest(pa.table(columns))

    ones = [1, 1]
    digests = [
        digest(x=pa.array(ones, pa.int32())),
        digest(y=pa.array(ones, pa.int32())),
        digest(x=pa.array(ones, pa.int64())),
        digest(x=pa.array(ones, pa.float64())),
        digest(x=pa.array(["ab", "c"])),
        digest(x=pa.array(["a", "bc"])),
        digest(x=pa.array([b"ab", b"c"])),
    ]
    assert len(set(digests)) == len(digests)


def test_a_columns_type_is_told_with_all_that_is_in_it_and_outlives_parquet():
    types = column_types(SCHEMA)
    assert types["pose"] == "list[3]<double>"
    assert types["path"] == "list<struct<t_s: double, x_m: double>>"
    assert types["rings"] == "list<list<list[2]<double>>>"
    assert types["image"] == "struct<bytes: binary, path: string>"
    assert (types["count"], types["flag"], types["when"]) == ("int32", "bool", "timestamp[us]")
    sink = io.BytesIO()
    pq.write_table(SCHEMA.empty_table(), sink)
    assert column_types(pq.read_table(sink).schema) == types


def test_an_item_has_the_digest_of_its_own_rows():
    rows = [{"id": "p", "v": 1, "w": 1}, {"id": "q", "v": 2, "w": 1}, {"id": "p", "v": 3, "w": 1}]
    before = item_digests(pa.Table.from_pylist(rows), "id")
    rows[2]["v"] = 4
    after = item_digests(pa.Table.from_pylist(rows), "id")
    assert list(before) == ["p", "q"]
    assert before["q"] == after["q"]
    assert before["p"] != after["p"]


def test_only_the_columns_of_the_identity_count():
    rows = [{"id": "p", "v": 1, "w": 1}]
    other = [{"id": "p", "v": 1, "w": 2}]
    by_v = [item_digests(pa.Table.from_pylist(r), "id", columns=["id", "v"]) for r in (rows, other)]
    assert by_v[0] == by_v[1]


def test_items_of_a_chunked_table_have_the_digests_of_a_whole_one():
    nested = pa.list_(pa.list_(pa.float64(), 2), 3)
    values = pa.array([[[i, i]] * 3 for i in range(6)], type=nested)
    ids = pa.array(list("aabbcc"))
    whole = pa.table({"id": ids, "value": values})
    pieces = pa.table({"id": ids, "value": pa.chunked_array([values.slice(0, 3), values.slice(3, 3)])})
    assert item_digests(pieces, "id") == item_digests(whole, "id")


def test_columns_that_are_compressed_already_are_stored_as_they_are():
    table = pa.table({"id": ["b", "a"], "blob": [b"x" * 100, b"y" * 100]})
    file = pq.ParquetFile(pa.BufferReader(parquet_bytes(table, Layout(uncompressed=("blob",)))))
    columns = [file.metadata.row_group(0).column(i) for i in range(2)]
    assert {c.path_in_schema: c.compression for c in columns} == {"id": "ZSTD", "blob": "UNCOMPRESSED"}


def test_items_stand_in_the_order_in_which_they_appear():
    table = pa.table({"id": ["b", "a", "b", "c"], "n": [0, 1, 2, 3]})
    digests = item_digests(table, "id")
    assert list(digests) == ["b", "a", "c"]
    assert digests["b"] == content_digest(table.take([0, 2]))
