"""Shards on disk: atomic, checked, resumed."""

from __future__ import annotations

import errno
import json
import os
import re
import sys
from dataclasses import replace
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from rendezvous.errors import StoreError
from rendezvous.store.disk import Disk
from rendezvous.store.read import Item, StageReader, chunks
from rendezvous.store.records import Inputs, Manifest, Quarantined, Shard
from rendezvous.store.tables import Layout, parquet_bytes
from rendezvous.store.verify import stage_folders, verify
from rendezvous.store.write import StageWriter, damage

LAYOUT = Layout(item_column="id", uncompressed=("blob",))


def shard_of(*ids: str) -> Shard:
    rows = [{"id": item, "n": n, "blob": bytes(200)} for item in ids for n in range(2)]
    return Shard(
        table=pa.Table.from_pylist(rows),
        counts={"items": len(ids)},
        quarantined=(Quarantined(item_id="bad", reason="crossed"),),
    )


def inputs_of(*ids: str, **parameters: object) -> Inputs:
    return Inputs(parameters=parameters, items={item: f"digest of {item}" for item in ids}, seed=0)


@pytest.fixture(params=["path", "uri"])
def root(request: pytest.FixtureRequest, tmp_path: Path) -> str:
    """A stage's folder, as a local path and as object storage is addressed."""
    folder = tmp_path / "toy"
    return str(folder) if request.param == "path" else folder.as_uri()


@pytest.fixture
def finished(root: str) -> tuple[str, Manifest]:
    """A finished folder of two shards and a card."""
    writer = StageWriter(root, "toy", LAYOUT)
    with writer.locked():
        records = [
            writer.write("part-00000.parquet", inputs_of("a", "b"), shard_of("a", "b")),
            writer.write("part-00001.parquet", inputs_of("c"), shard_of("c")),
        ]
        return root, writer.finish(records, {"README.md": b"# Card\n"})


def local(root: str) -> Path:
    return Path(root.removeprefix("file://"))


def test_what_is_written_is_read(finished):
    root, manifest = finished
    reader = StageReader(root, "toy")
    assert reader.manifest() == manifest
    assert manifest.rows == 6
    assert manifest.counts() == {"items": 3}
    assert [entry.reason for entry in manifest.quarantined] == ["crossed", "crossed"]
    assert [(row["id"], row["n"]) for row in reader.rows()] == [(i, n) for i in "abc" for n in (0, 1)]
    assert reader.table("part-00001.parquet", columns=["n"]).to_pydict() == {"n": [0, 1]}


def test_items_are_read_in_the_order_asked_for(finished):
    reader = StageReader(finished[0], "toy")
    a, b, c = reader.items()
    assert [item.shard for item in (a, b, c)] == ["part-00000.parquet"] * 2 + ["part-00001.parquet"]
    rows = list(reader.rows([c, b], item_column="id", columns=["n", "id"]))
    assert [(row["id"], row["n"]) for row in rows] == [("c", 0), ("c", 1), ("b", 0), ("b", 1)]
    assert set(rows[0]) == {"n", "id"}
    assert list(reader.rows([c], item_column="id", columns=["n"])) == [{"n": 0}, {"n": 1}]


def test_the_layout_is_as_asked_for(finished):
    file = pq.ParquetFile(local(finished[0]) / "part-00000.parquet")
    column = {name: file.metadata.row_group(0).column(i) for i, name in enumerate(file.schema.names)}
    assert column["blob"].compression == "UNCOMPRESSED"
    assert column["n"].compression == "ZSTD"
    assert all(c.has_offset_index and c.has_column_index for c in column.values())


def test_equal_tables_give_equal_bytes_however_they_are_chunked():
    table = shard_of("a", "b").table
    chunked = pa.concat_tables([table.slice(0, 1), table.slice(1)])
    assert parquet_bytes(table, LAYOUT) == parquet_bytes(chunked, LAYOUT)


def test_a_nested_column_can_be_left_uncompressed():
    table = pa.table({"image": [{"bytes": bytes(999), "path": None}], "other": [{"bytes": bytes(999)}]})
    data = parquet_bytes(table, Layout(uncompressed=("image",)))
    group = pq.ParquetFile(pa.BufferReader(data)).metadata.row_group(0)
    by_path = {group.column(i).path_in_schema: group.column(i).compression for i in range(3)}
    assert by_path == {"image.bytes": "UNCOMPRESSED", "image.path": "UNCOMPRESSED", "other.bytes": "ZSTD"}


def test_a_stage_that_did_not_run_is_named(root: str):
    with pytest.raises(StoreError, match=r"toy: no manifest.json.*run `rendezvous meshes` first"):
        StageReader(root, "meshes").manifest()


def test_a_damaged_shard_is_named_when_it_is_read(finished):
    path = local(finished[0]) / "part-00000.parquet"
    path.write_bytes(path.read_bytes()[:50])
    with pytest.raises(
        StoreError, match=r"part-00000.parquet: cannot be read .*`rendezvous toy` makes it again"
    ):
        list(StageReader(finished[0], "toy").rows())


def test_a_sound_folder_has_no_faults(finished):
    assert verify(finished[0]) == []


def truncate(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:-1])


def alter(path: Path) -> None:
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 1
    path.write_bytes(bytes(data))


@pytest.mark.parametrize(
    ("harm", "name", "said"),
    [
        (truncate, "part-00001.parquet", r"part-00001.parquet: file truncated: \d+ bytes, should be \d+"),
        (alter, "part-00001.parquet", r"part-00001.parquet: file altered: sha256 \w{12}…, should be \w{12}…"),
        (Path.unlink, "part-00001.parquet", "part-00001.parquet: file missing"),
        (alter, "README.md", r"README.md: file altered: sha256"),
        (
            Path.unlink,
            ".shards/part-00000.parquet.json",
            ".shards/part-00000.parquet.json: missing or differs from manifest.json",
        ),
        (Path.unlink, "manifest.json", "manifest.json: missing, so the stage has not finished"),
        (lambda path: path.write_text(""), "extra.txt", "extra.txt: not listed in manifest.json"),
    ],
)
def test_verify_finds_each_kind_of_harm_in_one_line(finished, harm, name: str, said: str):
    root, _ = finished
    harm(local(root) / name)
    (fault,) = verify(root)
    assert re.search(said, fault)
    assert "\n" not in fault


@pytest.mark.parametrize(
    "content", ["", "{", "[1, 2]", "3", "null", "{}", '{"shards": [[]], "files": []}', '{"shards": [{}]}']
)
def test_a_damaged_manifest_is_a_fault_like_others(finished, content: str):
    (local(finished[0]) / "manifest.json").write_text(content)
    (fault,) = verify(finished[0])
    assert re.search(r"manifest.json: damaged \(.*\); run the stage again$", fault)
    with pytest.raises(StoreError, match=r"manifest.json: damaged"):
        StageReader(finished[0], "toy").manifest()


@pytest.mark.parametrize("harm", [None, Path.unlink, truncate, lambda path: path.write_text("{")])
def test_only_what_an_earlier_run_wrote_is_removed(finished, harm):
    root, _ = finished
    folder = local(root)
    strangers = [
        "mine.parquet",
        "mine.tmp-old.txt",
        "old/part-00001.parquet",
        "meshes/manifest.json",
        "notes/README.md",
    ]
    for name in strangers:
        (folder / name).parent.mkdir(exist_ok=True)
        (folder / name).write_bytes(b"mine")
    (folder / "part-00007.parquet.tmp-123").write_bytes(b"half")
    if harm is not None:
        harm(folder / "manifest.json")
    writer = StageWriter(root, "toy", LAYOUT)
    with writer.locked():
        record = writer.finished("part-00000.parquet", inputs_of("a", "b"))
        writer.finish([record], {"README.md": b"# Card\n"})
    assert not [name for name in Disk(root).names() if "part-00001" in name and name not in strangers]
    assert [(folder / name).read_bytes() for name in strangers] == [b"mine"] * len(strangers)
    assert sorted(verify(root)) == sorted(f"{root}/{name}: not listed in manifest.json" for name in strangers)


def test_a_file_that_is_no_longer_beside_the_shards_is_removed(finished):
    root, manifest = finished
    writer = StageWriter(root, "toy", LAYOUT)
    with writer.locked():
        writer.finish(manifest.shards, {"CARD.md": b"# Card\n"})
    assert verify(root) == []
    assert not (local(root) / "README.md").exists()


def test_a_shard_never_lies_there_without_its_record(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    writer, write = StageWriter(str(tmp_path), "toy", LAYOUT), Disk.write
    unrecorded = []

    def watched(disk: Disk, name: str, data: bytes) -> None:
        write(disk, name, data)
        there = disk.names()
        unrecorded.extend(n for n in there if n.endswith(".parquet") and f".shards/{n}.json" not in there)

    monkeypatch.setattr(Disk, "write", watched)
    with writer.locked():
        writer.write("part-00000.parquet", inputs_of("a"), shard_of("a"))
        writer.make_room("part-00000.parquet", inputs_of("b"))
        writer.write("part-00000.parquet", inputs_of("b"), shard_of("b"))
        assert writer.finished("part-00001.parquet", inputs_of("a")) is not None
    assert unrecorded == []


def test_stage_folders_are_found_below_a_data_folder(finished, tmp_path: Path):
    root, _ = finished
    above = root.rpartition("/")[0]
    assert stage_folders(above) == [root]
    assert stage_folders(root) == [root]
    (tmp_path / "empty").mkdir()
    with pytest.raises(StoreError, match="empty: no stage's output here; `rendezvous dataset` makes some"):
        stage_folders(str(tmp_path / "empty"))


def test_a_finished_shard_is_found_by_its_inputs(finished):
    writer = StageWriter(finished[0], "toy", LAYOUT)
    with writer.locked():
        assert writer.finished("part-00000.parquet", inputs_of("a", "b")) == finished[1].shards[0]
        assert writer.finished("part-00000.parquet", inputs_of("b", "a")) is None


@pytest.mark.parametrize(
    ("inputs", "reason"),
    [
        (inputs_of("c", x=4.0), "x changed None -> 4.0"),
        (Inputs(parameters={}, items={"c": "digest of c"}, seed=1), "seed changed 0 -> 1"),
        (Inputs(parameters={}, items={"c": "digest of c"}), "seed changed 0 -> None"),
        (
            Inputs(parameters={}, items={"c": "digest of c"}, seed=0, version=2),
            "the stage's version changed 1 -> 2",
        ),
        (Inputs(parameters={}, items={"c": "other"}, seed=0), "upstream: c changed"),
        (inputs_of("c", "d"), "upstream: d is new"),
        (inputs_of(), "upstream: c is gone"),
        (inputs_of("p", "q", "r"), "upstream: p is new; upstream: q is new; upstream: r is new and 1 more"),
    ],
)
def test_the_reason_to_make_a_shard_again_is_told_in_words(finished, inputs: Inputs, reason: str):
    writer = StageWriter(finished[0], "toy", LAYOUT)
    with writer.locked():
        assert writer.finished("part-00001.parquet", inputs) is None
        assert writer.reason_to_make("part-00001.parquet", inputs) == reason


@pytest.mark.parametrize(
    ("old", "new", "reasons"),
    [
        ({"a": "double"}, {"a": "double"}, []),
        ({"a": "double"}, {"a": "double", "b": "string"}, ["columns: b is new"]),
        ({"a": "double", "b": "string"}, {"b": "string"}, ["columns: a is gone"]),
        ({"a": "double"}, {"a": "int32"}, ["columns: a changed"]),
        ({"a": "double", "b": "int32"}, {"b": "int32", "a": "double"}, ["columns: the order changed"]),
        ({}, {"a": "double"}, ["its columns were not recorded"]),
    ],
)
def test_columns_are_inputs(old: dict[str, str], new: dict[str, str], reasons: list[str]):
    before, after = (Inputs(parameters={}, columns=c, items={"a": "1"}) for c in (old, new))
    assert after.changes_since(before) == reasons
    assert (after.fingerprint() == before.fingerprint()) == (not reasons)
    moved = Inputs(parameters={}, columns=new, items={"b": "2"})
    assert before.differs_in_items_only(moved) == (old == new)


def test_a_manifest_keeps_columns_and_one_from_before_they_were_recorded_is_read(finished):
    manifest = finished[1]
    inputs = replace(manifest.shards[0].inputs, columns={"id": "string"})
    known = replace(manifest, shards=(replace(manifest.shards[0], inputs=inputs), manifest.shards[1]))
    fields = json.loads(json.dumps(known.to_json()))
    assert Manifest.from_json(fields) == known
    for shard in fields["shards"]:
        del shard["inputs"]["columns"]
    del fields["columns"]
    assert Manifest.from_json(fields) == manifest


@pytest.mark.parametrize(("shard", "table"), [("part-0.parquet", "toy"), ("pairs/part-0.parquet", "pairs")])
def test_a_missing_column_is_named_with_its_table_and_file(tmp_path: Path, shard: str, table: str):
    StageWriter(str(tmp_path), "toy", LAYOUT).write(shard, inputs_of("a"), shard_of("a"))
    said = f"{tmp_path}/{shard}: table {table} has no column 'm'; `rendezvous toy` makes it again"
    with pytest.raises(StoreError, match=f"^{re.escape(said)}$"):
        StageReader(str(tmp_path), "toy").table(shard, columns=["id", "m", "k"])


@pytest.mark.parametrize(("inputs", "kept"), [(inputs_of("new"), True), (inputs_of("a", "b", x=1), False)])
def test_only_a_shard_that_may_come_back_is_set_aside(finished, inputs: Inputs, kept: bool):
    writer = StageWriter(finished[0], "toy", LAYOUT)
    with writer.locked():
        writer.make_room("part-00000.parquet", inputs)
    assert any("aside-" in name for name in Disk(finished[0]).names()) == kept


def test_nested_parameters_are_told_by_their_own_keys():
    def inputs(size_m: tuple[float, float]) -> Inputs:
        return inputs_of("c", robot={"name": "burger", "size_m": size_m})

    assert inputs((1.0, 2.0)).changes_since(inputs((1.0, 3.0))) == [
        "robot.size_m changed [1.0, 3.0] -> [1.0, 2.0]"
    ]


def test_an_order_of_items_is_an_input():
    assert inputs_of("b", "a").changes_since(inputs_of("a", "b")) == ["upstream: the order changed"]
    assert inputs_of("b", "a").fingerprint() != inputs_of("a", "b").fingerprint()


@pytest.mark.parametrize("harm", [truncate, alter, Path.unlink])
def test_a_harmed_shard_is_not_taken_for_finished(finished, harm):
    harm(local(finished[0]) / "part-00001.parquet")
    writer = StageWriter(finished[0], "toy", LAYOUT)
    with writer.locked():
        assert writer.finished("part-00001.parquet", inputs_of("c")) is None
        assert writer.reason_to_make("part-00001.parquet", inputs_of("c")).startswith("file ")


def test_two_runs_cannot_write_to_one_folder(tmp_path: Path):
    first, second = (StageWriter(str(tmp_path / "toy"), "toy") for _ in range(2))
    with (
        first.locked(),
        pytest.raises(StoreError, match="toy: another run is writing here; wait or stop it"),
        second.locked(),
    ):
        pass
    with second.locked():
        pass


@pytest.mark.parametrize("reason", [errno.ENOSPC, errno.EDQUOT])
def test_a_full_disk_leaves_nothing_half_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, reason: int
):
    def full(descriptor: int) -> None:
        raise OSError(reason, os.strerror(reason))

    disk = Disk(str(tmp_path))
    disk.write("kept", b"kept")
    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(StoreError, match=r"new: the disk is full; finished shards are kept: free some space"):
        disk.write("new", b"new")
    with pytest.raises(StoreError, match="the disk is full"):
        disk.write("kept", b"other")
    assert disk.names() == ["kept"]
    assert disk.read("kept") == b"kept"


def test_a_folder_that_cannot_be_written_is_told(tmp_path: Path):
    (tmp_path / "file").write_text("")
    writer = StageWriter(str(tmp_path / "file" / "toy"), "toy")
    with pytest.raises(StoreError, match=r"toy: cannot be written \(Not a directory\)"), writer.locked():
        pass


def test_a_uri_of_no_known_kind_is_told():
    with pytest.raises(StoreError, match="nowhere://bucket: cannot be opened"):
        Disk("nowhere://bucket").names()


def test_chunks_do_not_cross_shards():
    items = [Item(item_id=i, digest="", shard=s) for i, s in ["a0", "b0", "c0", "d1", "e1"]]
    assert ["".join(item.item_id for item in chunk) for chunk in chunks(items, 2)] == ["ab", "c", "de"]
    more = [*items, Item(item_id="f", digest="", shard="2")]
    assert list(chunks(more, 2))[:3] == list(chunks(items, 2))


@pytest.mark.parametrize(("encoding", "told"), [("utf-8", False), ("ascii", True)])
def test_a_name_that_a_locale_garbled_is_told_with_what_helps(monkeypatch, encoding: str, told: bool):
    """With `LC_ALL=C` and without UTF-8 mode Python takes the bytes of `ü` for halves of characters."""
    monkeypatch.setattr(sys, "getfilesystemencoding", lambda: encoding)
    with pytest.raises(StoreError, match=r"is not UTF-8; must name a folder in it") as caught:
        Disk("data-\udcc3\udcbc").names()
    assert str(caught.value).endswith("; names are taken for ascii: PYTHONUTF8=1 helps") is told


@pytest.mark.parametrize(
    ("changes", "only_items"),
    [
        ({}, True),
        ({"seed": None}, True),
        ({"seed": 1}, False),
        ({"version": 2}, False),
        ({"columns": {"x": "double"}}, False),
        ({"parameters": {"a": 2}}, False),
        ({"parameters": {"b": 2}}, True),
        ({"items": {"p": "0"}}, False),
    ],
)
def test_a_shard_of_other_items_is_one_that_all_else_is_the_same_for(changes: dict, only_items: bool):
    old = Inputs(parameters={"a": 1}, items={"p": "0"}, seed=0)
    new = replace(old, **({"items": {"q": "1"}} | changes))
    assert old.differs_in_items_only(new) is only_items
    assert new.differs_in_items_only(old) is only_items


def test_what_is_wrong_with_a_file_is_told(finished: tuple[str, Manifest]):
    root, manifest = finished
    first, second = manifest.shards
    path = local(root) / first.name
    path.write_bytes(path.read_bytes() + b"xy")
    assert damage(Disk(root), first.name, first.bytes, first.sha256) == (
        f"file grown: {first.bytes + 2} bytes, should be {first.bytes}"
    )
    path.unlink()
    assert damage(Disk(root), first.name, first.bytes, first.sha256) == "file missing"
    assert damage(Disk(root), second.name, second.bytes, second.sha256) is None
    writer = StageWriter(root, "toy", LAYOUT)
    assert writer.reason_to_make(first.name, first.inputs) == "file missing"
    (local(root) / ".shards" / f"{second.name}.json").unlink()
    assert writer.reason_to_make(second.name, second.inputs) == "no record that it was finished"
    assert writer.reason_to_make("part-00002.parquet", second.inputs) == "not made yet"


def test_rows_of_items_come_in_the_order_asked_for_with_the_columns_asked_for(finished: tuple[str, Manifest]):
    reader = StageReader(finished[0])
    a, b, c = reader.items()
    assert [item.item_id for item in (a, b, c)] == ["a", "b", "c"]
    picked = list(reader.rows([c, b], item_column="id", columns=["n"]))
    assert picked == [{"n": 0}, {"n": 1}] * 2
    ids = [row["id"] for row in reader.rows([c, b, a], item_column="id")]
    assert ids == ["c", "c", "b", "b", "a", "a"]
    assert [row["id"] for row in reader.rows(columns=["id"])] == ["a", "a", "b", "b", "c", "c"]


def test_items_are_grouped_within_their_shards():
    items = [Item(item_id=str(n), digest="", shard="one" if n < 5 else "two") for n in range(8)]
    assert [[item.item_id for item in group] for group in chunks(items, 2)] == [
        ["0", "1"], ["2", "3"], ["4"], ["5", "6"], ["7"]
    ]  # fmt: skip
