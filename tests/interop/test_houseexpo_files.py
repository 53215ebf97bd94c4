"""Plan files under odd names and with odd text; what sources hold is tested with the stage `floorplans`."""

from __future__ import annotations

import gzip
import io
import os
import tarfile
from pathlib import Path

import pytest

from rendezvous.errors import ConfigError, FloorplanError
from rendezvous.interop.houseexpo_files import (
    LARGEST_PLAN_BYTES,
    check_source,
    count_plan_files,
    parsed_json,
    plan_files,
)

NAMES = ["a.json", "b.JSON", "c.Json", "d.json.gz", "e.JSON.GZ"]


def content_of(name: str) -> bytes:
    text = f'{{"id": "{name[0]}"}}'.encode()
    return gzip.compress(text) if name.lower().endswith(".gz") else text


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "plans").mkdir()
    for name in (*NAMES, "notes.txt"):
        (tmp_path / "plans" / name).write_bytes(content_of(name))
    return tmp_path / "plans"


def archived(folder: Path, path: Path, mode: str) -> Path:
    with tarfile.open(path, mode) as archive:
        for file in sorted(folder.iterdir()):
            archive.add(file, arcname=f"json/{file.name}")
    return path


def test_suffixes_may_be_in_capitals_and_files_zipped(folder: Path):
    found = list(plan_files(str(folder)))
    assert [Path(file.source).name for file in found] == NAMES
    assert [parsed_json(file.content, "x")["id"] for file in found] == list("abcde")
    assert count_plan_files(str(folder)) == len(NAMES)
    for name in NAMES:
        check_source(str(folder / name))
        (file,) = plan_files(str(folder / name))
        assert file.content == f'{{"id": "{name[0]}"}}'.encode()


@pytest.mark.parametrize(("name", "mode"), [("p.TAR", "w"), ("p.Tar.GZ", "w:gz"), ("p.TGZ", "w:gz")])
def test_archives_may_be_in_capitals_too(folder: Path, tmp_path: Path, name: str, mode: str):
    path = archived(folder, tmp_path / name, mode)
    check_source(str(path))
    assert count_plan_files(str(path)) is None
    found = list(plan_files(str(path)))
    assert [file.source for file in found] == [f"{path}:json/{name}" for name in NAMES]
    assert [parsed_json(file.content, "x")["id"] for file in found] == list("abcde")


def test_another_file_is_no_source(folder: Path):
    with pytest.raises(ConfigError, match=r"must end in \.json, \.tar"):
        check_source(str(folder / "notes.txt"))


def test_a_name_that_is_not_utf8_is_a_fault_that_can_be_written(folder: Path, tmp_path: Path):
    (folder / os.fsdecode(b"\xb5\xd8.json")).write_bytes(b"{}")
    archive = archived(folder, tmp_path / "plans.tar", "w")
    for source in (folder, archive):
        found = [file for file in plan_files(str(source)) if file.fault]
        assert [(file.content, file.fault) for file in found] == [(b"", "its name is not UTF-8; rename it")]
        assert found[0].source.encode().endswith(rb"\udcb5\udcd8.json")
        assert len(list(plan_files(str(source)))) == len(NAMES) + 1


@pytest.mark.parametrize(
    "content",
    [b'{"id": "\\ud83d"}', b'["\\udc00\\ud800"]', b'{"\\udfff": 1}', b'"\xed\xa0\x80"'],
)
def test_half_a_character_in_json_is_told(content: bytes):
    with pytest.raises(
        FloorplanError, match=r"\Ax: text with '\\ud...', half a character; must be Unicode\Z"
    ):
        parsed_json(content, "x")


def test_whole_characters_in_json_are_read():
    assert parsed_json(b'"\\ud83d\\ude00 \xc3\xbc"', "x") == "\U0001f600 ü"


@pytest.mark.parametrize("content", [b"", b"{", b"\xff\xfe{", b"[" * 100_000, b'"\xe4"'])
def test_what_is_no_json_is_told(content: bytes):
    with pytest.raises(FloorplanError, match="x: not JSON "):
        parsed_json(content, "x")


def test_what_unpacks_to_too_much_or_is_damaged_is_a_fault(tmp_path: Path):
    zipped = gzip.compress(bytes(LARGEST_PLAN_BYTES + 1))
    for name, content, fault in (
        ("bomb.json.gz", zipped, f"a floor plan has at most {LARGEST_PLAN_BYTES}: is it one?"),
        ("cut.json.gz", gzip.compress(b"[1, 2, 3]")[:-9], "damaged (its end is missing)"),
        ("bad.json.gz", zipped[:20] + bytes(20), "damaged ("),
    ):
        (tmp_path / name).write_bytes(content)
        (file,) = plan_files(str(tmp_path / name))
        assert fault in file.fault
        assert file.content == b""


def test_a_member_of_exactly_the_largest_size_is_read_and_one_more_is_not(tmp_path: Path):
    with tarfile.open(tmp_path / "p.tar", "w") as archive:
        for extra in (0, 1):
            header = tarfile.TarInfo(f"{extra}.json")
            header.size = LARGEST_PLAN_BYTES + extra
            archive.addfile(header, io.BytesIO(bytes(header.size)))
    whole, large = plan_files(str(tmp_path / "p.tar"))
    assert (len(whole.content), whole.fault) == (LARGEST_PLAN_BYTES, "")
    assert f"{LARGEST_PLAN_BYTES + 1} bytes; a floor plan has at most" in large.fault


def test_a_pipe_a_device_and_a_folder_among_plans_are_faults(folder: Path):
    os.mkfifo(folder / "pipe.json")
    (folder / "device.json").symlink_to("/dev/zero")
    (folder / "endless.json.gz").symlink_to("/dev/urandom")
    (folder / "deep.json").mkdir()
    faults = {Path(file.source).name: file.fault for file in plan_files(str(folder)) if file.fault}
    assert faults == {
        "pipe.json": "is no regular file",
        "device.json": "is no regular file",
        "endless.json.gz": "is no regular file",
        "deep.json": "is a directory",
    }


@pytest.mark.parametrize("name", ["pipe.json", "pipe.tar", "pipe.json.gz"])
def test_a_pipe_is_no_source(tmp_path: Path, name: str):
    os.mkfifo(tmp_path / name)
    with pytest.raises(ConfigError, match="is a device or pipe; must be a file or a folder"):
        check_source(str(tmp_path / name))


@pytest.mark.parametrize("source", ["x" * 5000 + ".json", "a\0b.json", "\udcff.json"])
def test_a_name_that_no_file_has_is_not_found(source: str):
    with pytest.raises(ConfigError, match=r"\Afloorplans\.sources: .{1,200} not found"):
        check_source(source)


def test_a_folder_may_be_called_like_an_archive(folder: Path):
    named = folder.rename(folder.with_suffix(".tar"))
    check_source(str(named))
    assert count_plan_files(str(named)) == len(list(plan_files(str(named)))) == len(NAMES)


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b'{"id": ' + b"[" * 30 + b"]" * 30 + b"}", "more than 20 levels deep"),
        (b'{"a":' * 900 + b"1" + b"}" * 900, "more than 20 levels deep"),
        (b"[" + b"[]," * 500_000 + b"[]]", "more than 400,000 values"),
        (b"[" + b"9" * 5000 + b"]", "not JSON"),
    ],
)
def test_json_that_is_no_plan_is_told_before_it_fills_the_memory(content: bytes, said: str):
    with pytest.raises(FloorplanError, match=rf"\Ax: {said}"):
        parsed_json(content, "x")
