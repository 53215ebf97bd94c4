"""Records, manifests and shards that hold something else: named in one line, and made again as they were."""

from __future__ import annotations

import copy
import json
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rendezvous.engine.run import part_name
from rendezvous.errors import StoreError
from rendezvous.store.disk import Disk
from rendezvous.store.json_types import require_file_name
from rendezvous.store.read import StageReader, read_manifest, read_record
from rendezvous.store.records import MANIFEST, Manifest, ShardRecord
from rendezvous.store.verify import verify
from tests.toy_stage import LAYOUT, STAGE, folder_content, item_names, run_of, toy_tasks

SHARD = part_name(1)


def made(data: Path) -> Path:
    """The toy stage's folder, made where it is not sound."""
    tasks = toy_tasks(item_names(6))
    run_of(str(data)).build(STAGE, tasks, layout=LAYOUT, total=len(tasks))
    return data / STAGE


@pytest.fixture(scope="module")
def sound(tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    return folder_content(made(tmp_path_factory.mktemp("sound")))


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return made(tmp_path)


RECORD: dict[str, Any] = {
    "name": "part-00000.parquet",
    "bytes": 1,
    "sha256": "",
    "content_digest": "",
    "rows": 1,
    "counts": {"a": 1},
    "quarantined": [{"item_id": "a", "reason": "b", "where": ""}],
    "items": {"a": "b"},
    "versions": {"a": "b"},
    "inputs": {"parameters": {"a": 1}, "items": {"a": "b"}, "columns": {"a": "b"}, "seed": 0, "version": 1},
}
WRONG = [None, True, 1.5, -1, "x", [], ["x"], {}, {"x": []}, float("nan"), float("inf"), {"x": float("nan")}]


def changed(fields: dict[str, Any], key: str, value: Any) -> dict[str, Any]:
    fields = copy.deepcopy(fields)
    *parents, last = key.split(".")
    place = fields
    for parent in parents:
        place = place[parent]
    place[last] = value
    return fields


KEYS = [*RECORD, *(f"inputs.{key}" for key in RECORD["inputs"])]


@pytest.mark.parametrize("key", KEYS)
def test_a_record_with_a_value_of_another_type_is_none(tmp_path: Path, key: str):
    disk = Disk(str(tmp_path))
    path = tmp_path / ShardRecord.record_name("part-00000.parquet")
    path.parent.mkdir()
    path.write_text(json.dumps(RECORD))
    assert read_record(disk, "part-00000.parquet") is not None
    right = RECORD["inputs"][key.split(".")[1]] if "." in key else RECORD[key]
    for value in WRONG:
        path.write_text(json.dumps(changed(RECORD, key, value)))
        found = read_record(disk, "part-00000.parquet")
        like = isinstance(value, type(right)) and not isinstance(value, bool)
        assert found is None or like or value is None
        if found is not None:
            found.inputs.fingerprint()


@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"[]",
        b"null",
        b"[[1, 2]]",
        b"\xff\xfe",
        b"[" * 100_000,
        b'{"a":' * 3000,
        b"1" * 5000,
        b'{"name": NaN}',
    ],
)
@pytest.mark.parametrize("name", [MANIFEST, ShardRecord.record_name(SHARD)])
def test_json_of_any_other_kind_is_named_and_made_again(
    folder: Path, sound: dict[str, bytes], name: str, content: bytes
):
    (folder / name).write_bytes(content)
    (fault, *_) = verify(str(folder))
    assert name in fault
    assert "\n" not in fault
    made(folder.parent)
    assert folder_content(folder) == sound


@pytest.mark.parametrize(
    "change",
    [
        lambda record: {**record, "name": part_name(0)},
        lambda record: {**record, "name": "../part-00001.parquet"},
        lambda record: changed(record, "inputs.parameters", {"toy.scale": float("nan")}),
        lambda record: {**record, "bytes": "many"},
        lambda record: {**record, "items": list(record["items"])},
        lambda record: {**record, "more": 1},
    ],
)
def test_a_record_that_is_not_its_shards_is_made_again(
    folder: Path, sound: dict[str, bytes], change: Callable[[dict[str, Any]], dict[str, Any]]
):
    path = folder / ShardRecord.record_name(SHARD)
    path.write_text(json.dumps(change(json.loads(path.read_bytes()))))
    assert read_record(Disk(str(folder)), SHARD) is None
    assert any(SHARD in fault for fault in verify(str(folder)))
    made(folder.parent)
    assert folder_content(folder) == sound


@pytest.mark.parametrize("name", ["", ".", "/etc/passwd", "../a", "a/../b", "a//b", "a\0b"])
def test_no_name_leads_out_of_a_folder(folder: Path, name: str):
    with pytest.raises(ValueError, match="is no file below this folder"):
        require_file_name(name)
    fields = json.loads((folder / MANIFEST).read_bytes())
    for place in (fields["shards"][0], {"files": 1}):
        if "name" in place:
            place["name"] = name
        else:
            fields["files"] = [{"name": name, "bytes": 1, "sha256": ""}]
        (folder / MANIFEST).write_text(json.dumps(fields))
        with pytest.raises(StoreError, match=r"manifest\.json: damaged .*run the stage again"):
            read_manifest(Disk(str(folder)))


def other_schema(path: Path, column: str, values: pa.Array | None) -> None:
    table = pq.read_table(path)
    index = table.column_names.index(column)
    table = table.remove_column(index)
    pq.write_table(table if values is None else table.add_column(index, column, values), path)


@pytest.mark.parametrize(
    ("values", "said"),
    [
        (None, "has no column 'values'"),
        (pa.array(["a"] * 6), r"column 'values' of table floorplans is string; must be list<double>"),
        (pa.array([[1]] * 6), r"column 'values' of table floorplans is list<int64>; must be list<double>"),
        (pa.array([[float("nan")]] * 6, pa.list_(pa.float32())), "is list<float>; must be list<double>"),
    ],
)
def test_a_shard_of_another_schema_is_named_and_made_again(
    folder: Path, sound: dict[str, bytes], values: pa.Array | None, said: str
):
    other_schema(folder / SHARD, "values", values)
    with pytest.raises(StoreError, match=rf"\A[^\n]*{SHARD}: [^\n]*{said}[^\n]*makes it again\Z"):
        StageReader(str(folder), STAGE).table(SHARD, columns=["values"])
    made(folder.parent)
    assert folder_content(folder) == sound


@given(st.data())
def test_a_manifest_with_any_value_replaced_is_one_error_or_none(data: st.DataObject):
    fields = Manifest(stage="toy", shards=(ShardRecord.from_json(RECORD),)).to_json()
    place: Any = fields
    while isinstance(place, dict | list) and place:
        keys = sorted(place) if isinstance(place, dict) else range(len(place))
        key = data.draw(st.sampled_from(list(keys)))
        if data.draw(st.booleans()) or not isinstance(place[key], dict | list) or not place[key]:
            place[key] = data.draw(st.sampled_from(WRONG))
            break
        place = place[key]
    try:
        manifest = Manifest.from_json(fields)
    except (AttributeError, KeyError, TypeError, ValueError):
        return
    manifest.counts()
    for shard in manifest.shards:
        shard.inputs.fingerprint()


@given(st.binary(max_size=30), st.integers(0, 10_000))
def test_a_shard_with_any_bytes_changed_is_read_or_named(sound: dict[str, bytes], change: bytes, at: int):
    content = bytearray(sound[SHARD])
    at %= len(content)
    content[at : at + len(change)] = change
    with tempfile.TemporaryDirectory() as root:
        (Path(root) / SHARD).write_bytes(content)
        try:
            StageReader(root, STAGE).table(SHARD).to_pylist()
        except StoreError as error:
            assert SHARD in str(error)  # noqa: PT017 - or it is read
