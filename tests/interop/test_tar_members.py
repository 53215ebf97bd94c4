"""Archives that lie about themselves end in one line, whole ones are read as `tarfile` reads them."""

from __future__ import annotations

import gzip
import io
import os
import tarfile
import time
import tracemalloc
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rendezvous.errors import FloorplanError
from rendezvous.interop.houseexpo_files import PlanFile, plan_files
from rendezvous.interop.tar_members import LONGEST_HEADER_BYTES, MOST_HEADERS, DamagedTarError, TarStream

PLAN = b'{"id": "a"}'
NOTHING = MappingProxyType[int, bytes]({})
MOST_S, MOST_BYTES = 10.0, 100_000_000


def header(
    name: str = "a.json",
    size: int | bytes = len(PLAN),
    kind: bytes = b"0",
    *,
    fields: Mapping[int, bytes] = NOTHING,
) -> bytes:
    """A header whose checksum is right, whatever else is not."""
    block = bytearray(tarfile.TarInfo(name).tobuf(tarfile.GNU_FORMAT))
    digits = size if isinstance(size, bytes) else tarfile.itn(size, 12, tarfile.GNU_FORMAT)  # type: ignore[attr-defined]
    block[124:136], block[156:157] = digits, kind
    for at, value in fields.items():
        block[at : at + len(value)] = value
    block[148:156] = b" " * 8
    block[148:156] = b"%06o\0 " % sum(block)
    return bytes(block)


def padded(content: bytes) -> bytes:
    return content + bytes(-len(content) % 512)


GOOD = header("good.json") + padded(PLAN)
END = bytes(1024)


def pax(*records: tuple[str, str]) -> bytes:
    lines = b""
    for key, value in records:
        rest = f" {key}={value}\n".encode(errors="surrogateescape")
        length = len(rest)
        while len(str(length)) + len(rest) != length:
            length = len(str(length)) + len(rest)
        lines += str(length).encode() + rest
    return header("pax", len(lines), b"x") + padded(lines)


def read(path: Path, content: bytes) -> list[PlanFile]:
    """The plans of an archive, in bounded time and memory."""
    path.write_bytes(content)
    began_s = time.process_time()
    tracemalloc.start()
    try:
        return list(plan_files(str(path)))
    finally:
        used_bytes = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        assert time.process_time() - began_s < MOST_S
        assert used_bytes < MOST_BYTES


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (header(size=1 << 60) + PLAN, "2 plans"),
        (header("other.png", size=1 << 60) + PLAN, "1 plans"),
        (header(size=(1 << 33) - 1), "2 plans"),
        (header(size=b"\xff" * 12) + PLAN, "is no size"),
        (header(size=b"-0000000001\0"), "is no size"),
        (header(size=b"99999999999\0"), "is no size"),
        (pax(("size", "9" * 18)) + header(), "2 plans"),
        (pax(("size", "-1")) + header(), "is no size"),
        (pax(("size", "x")) + header(), "is no size"),
        (header("pax", 1 << 33, b"x"), "a name or header of 8,589,934,592 bytes"),
        (header("pax", 1 << 40, b"g"), "a name or header of"),
        (header("long", 1 << 60, b"L"), "a name or header of"),
        (header("link", LONGEST_HEADER_BYTES + 1, b"K"), "a name or header of 65,537 bytes"),
        (header("pax", 20, b"x") + padded(b"99999999999 a=b\n    "), "bad pax records"),
        (header("pax", 8, b"x") + padded(b"0 a=bbb\n"), "bad pax records"),
        (header("pax", 8, b"x") + padded(b"nothing\n"), "bad pax records"),
        (header(kind=b"S", fields={482: b"\1"}), "its end is missing"),
        (bytes(100) + b"x" + bytes(411), "bad checksum"),
        (b"\xff" * 512, "is no size|bad checksum"),
    ],
)
@pytest.mark.parametrize("zipped", [False, True])
def test_an_archive_that_claims_what_it_has_not_is_one_line(
    tmp_path: Path, content: bytes, said: str, *, zipped: bool
):
    whole = GOOD + content
    with pytest.raises(FloorplanError, match=rf"\A[^\n]*plans\.tar: damaged after (?=[^\n]*\Z).*({said})"):
        read(tmp_path / "plans.tar", gzip.compress(whole) if zipped else whole)


def test_long_headers_are_read_and_too_many_are_told(tmp_path: Path):
    longest = header("long", LONGEST_HEADER_BYTES, b"L") + padded(b"x" * LONGEST_HEADER_BYTES)
    records = pax(*((f"key{n}", "v" * 1000) for n in range(60)), ("path", "good.json"))
    pair = longest + records
    found = read(tmp_path / "plans.tgz", gzip.compress((pair * (MOST_HEADERS // 2) + GOOD) * 20 + END))
    assert [file.fault for file in found] == [""] * 20
    with pytest.raises(FloorplanError, match="more than 8 names and headers before a member"):
        read(tmp_path / "plans.tgz", gzip.compress(pair * (MOST_HEADERS // 2) + records + GOOD + END))


@pytest.mark.parametrize(
    "member",
    [
        header(kind=b"S", fields={386: b"x" * 24, 483: b"xx"}) + padded(PLAN),
        header(kind=b"S", fields={482: b"\1"}) + bytes(512) + padded(PLAN),
        pax(("GNU.sparse.map", "abc"), ("GNU.sparse.size", "xx")) + header() + padded(PLAN),
        pax(("GNU.sparse.major", "1"), ("GNU.sparse.minor", "0")) + header() + padded(PLAN),
    ],
)
def test_a_sparse_member_is_a_fault_and_the_next_is_read(tmp_path: Path, member: bytes):
    sparse, good = read(tmp_path / "plans.tar", member + GOOD + END)
    assert sparse.fault == "a sparse file; pack it without --sparse"
    assert (good.content, good.fault) == (PLAN, "")


def test_a_name_that_is_not_utf8_is_a_fault_in_any_form(tmp_path: Path):
    plain = header(os.fsdecode(b"\xff.json")) + padded(PLAN)
    by_pax = pax(("path", os.fsdecode(b"\xfe.json"))) + header() + padded(PLAN)
    found = read(tmp_path / "plans.tar", plain + by_pax + GOOD + END)
    assert [file.fault for file in found] == ["its name is not UTF-8; rename it"] * 2 + [""]


NAMES = st.text(st.characters(blacklist_characters="\0/", codec="utf-8"), min_size=1, max_size=150)


@given(
    members=st.lists(st.tuples(NAMES, st.binary(max_size=1500)), max_size=5),
    folder=st.sampled_from(["", "f/", "f" * 90 + "/" + "g" * 40 + "/"]),
    form=st.sampled_from([tarfile.USTAR_FORMAT, tarfile.GNU_FORMAT, tarfile.PAX_FORMAT]),
)
def test_a_whole_archive_is_read_as_tarfile_reads_it(
    members: list[tuple[str, bytes]], folder: str, form: int
):
    packed = io.BytesIO()
    with tarfile.open(fileobj=packed, mode="w", format=form) as archive:
        for name, content in members:
            info = tarfile.TarInfo(folder + name)
            info.size = len(content)
            try:
                archive.addfile(info, io.BytesIO(content))
            except ValueError:  # too long a name for ustar
                continue
            link = tarfile.TarInfo(f"{folder}link")
            link.type, link.linkname = tarfile.SYMTYPE, "x" * 150 if form != tarfile.USTAR_FORMAT else "x"
            archive.addfile(link)
    packed.seek(0)
    with tarfile.open(fileobj=packed) as archive:
        wanted = [
            (info.name, file.read() if (file := archive.extractfile(info)) else b"")
            for info in archive.getmembers()
            if info.isfile()
        ]
    packed.seek(0)
    found = [(member.name, member.read()) for member in TarStream(packed).members() if member.is_file]
    assert found == wanted


@given(st.binary(max_size=600), st.integers(0, 2000))
def test_any_damage_is_told_or_does_no_harm(damage: bytes, at: int):
    content = bytearray(pax(("path", "long.json")) + header() + padded(PLAN) + GOOD + END)
    content[at : at + len(damage)] = damage
    try:
        for member in TarStream(io.BytesIO(bytes(content))).members():
            member.read()
    except DamagedTarError:
        pass
