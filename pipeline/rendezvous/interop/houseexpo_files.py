"""HouseExpo's JSON files on disk: one file, a folder of them, or the dataset's `json.tar.gz` as a stream.

Suffixes may be written in capitals, as Windows programs do.
"""

from __future__ import annotations

import gzip
import json
import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, BinaryIO, cast

from rendezvous.errors import ConfigError, FloorplanError
from rendezvous.interop.given_file import given_bytes
from rendezvous.interop.tar_members import DamagedTarError, TarStream
from rendezvous.resources import exists, located

LARGEST_PLAN_BYTES = 16_000_000  # larger files are not read; HouseExpo's largest plan has 0.2 MB
DEEPEST_JSON = 20  # levels; a plan has 4
MOST_COMMAS = 400_000  # no more values are parsed: a million take 100 MB; HouseExpo's largest plan has 12,000

_GZIP_MAGIC = b"\x1f\x8b"


@dataclass(frozen=True, slots=True, kw_only=True)
class PlanFile:
    """One file of a source."""

    source: str  # its path, or `archive.tar.gz:member`; bytes that are not UTF-8 are escaped
    content: bytes = b""  # its bytes, not yet parsed
    fault: str = ""  # why it cannot be read; empty if it can


def check_source(source: str) -> None:
    """Check that a source can be read.

    Raises:
        ConfigError: there is no such file or folder, or it is of another kind.
    """
    path = located(source)
    if not exists(path):
        raise ConfigError(
            f"floorplans.sources: {source!r:.200} not found; must be a HouseExpo JSON file, a folder of them "
            "or a json.tar.gz, relative to where the command runs"
        )
    if path.is_dir():
        return
    if not path.is_file():
        raise ConfigError(f"floorplans.sources: {source!r} is a device or pipe; must be a file or a folder")
    if not (_is_archive(path) or _is_plan(path.name)):
        raise ConfigError(f"floorplans.sources: {source!r}; must end in .json, .tar, .tar.gz or .tgz")


def count_plan_files(source: str) -> int | None:
    """The number of files in a source; None for an archive, which would have to be read for it."""
    path = located(source)
    return None if _is_archive(path) else len(_listed(path))


def plan_files(source: str) -> Iterator[PlanFile]:
    """All files of a source, one in memory at a time, in an order that does not depend on the disk.

    Raises:
        FloorplanError: an archive is damaged.
    """
    path = located(source)
    for file in _archived(path) if _is_archive(path) else map(_read, _listed(path)):
        # A shipped file goes by the name it was asked for: where the package lies is no part of the data.
        name = f"{Path(source)}{file.source.removeprefix(str(path))}"
        yield replace(file, source=name.encode(errors="backslashreplace").decode())


def parsed_json(content: bytes, source: str) -> Any:
    """The value in a plan file.

    Raises:
        FloorplanError: it is not JSON, or holds text that is not Unicode.
    """
    if content.count(b",") > MOST_COMMAS:
        raise FloorplanError(f"{source}: more than {MOST_COMMAS:,} values; must be one floor plan")
    try:
        value = json.loads(content)
        if _is_deep(value, DEEPEST_JSON):
            raise FloorplanError(f"{source}: more than {DEEPEST_JSON} levels deep; must be one floor plan")
        json.dumps(value, ensure_ascii=False).encode()
    except UnicodeEncodeError as error:
        raise FloorplanError(
            f"{source}: text with {error.object[error.start]!a}, half a character; must be Unicode"
        ) from error
    except (ValueError, RecursionError) as error:
        raise FloorplanError(f"{source}: not JSON ({error}); must be one floor plan") from error
    return value


def _is_deep(value: Any, levels: int) -> bool:
    if not isinstance(value, dict | list):
        return False
    inner = value.values() if isinstance(value, dict) else value
    return levels == 0 or any(
        _is_deep(below, levels - 1) for below in inner if isinstance(below, dict | list)
    )


def _is_archive(path: Path) -> bool:
    return not path.is_dir() and path.name.lower().endswith((".tar", ".tar.gz", ".tgz"))


def _is_plan(name: str) -> bool:
    return name.lower().endswith((".json", ".json.gz"))


def _listed(path: Path) -> list[Path]:
    return sorted(p for p in path.rglob("*") if _is_plan(p.name)) if path.is_dir() else [path]


def _read(path: Path) -> PlanFile:
    try:
        # A pipe or a device, which may never end, is not opened.
        return _plan_file(str(path), path.stat().st_size, lambda: given_bytes(path))
    except OSError as error:
        return PlanFile(source=str(path), fault=(error.strerror or str(error)).lower())


def _plan_file(source: str, size_bytes: int, read: Callable[[], bytes]) -> PlanFile:
    """The file, unzipped, or why it cannot be used; a file that is too large is not read."""
    if source.encode(errors="ignore").decode() != source:
        return PlanFile(source=source, fault="its name is not UTF-8; rename it")
    content = read() if size_bytes <= LARGEST_PLAN_BYTES else b""
    if content.startswith(_GZIP_MAGIC):
        unzip = zlib.decompressobj(wbits=31)
        try:
            content = unzip.decompress(content, LARGEST_PLAN_BYTES + 1)
        except zlib.error as error:
            return PlanFile(source=source, fault=f"damaged ({error})")
        size_bytes = len(content)
        if not unzip.eof and size_bytes <= LARGEST_PLAN_BYTES:
            return PlanFile(source=source, fault="damaged (its end is missing)")
    if size_bytes > LARGEST_PLAN_BYTES:
        fault = f"{size_bytes} bytes; a floor plan has at most {LARGEST_PLAN_BYTES}: is it one?"
        return PlanFile(source=source, fault=fault)
    return PlanFile(source=source, content=content)


def _archived(path: Path) -> Iterator[PlanFile]:
    members = 0
    try:
        with _opened(path) as stream:
            archive = TarStream(stream)
            for member in archive.members():
                name = member.name.rpartition("/")[2]
                if not member.is_file or not _is_plan(name) or name.startswith("._"):
                    continue
                members += 1
                source = f"{path}:{member.name}"
                if member.is_sparse:
                    yield PlanFile(source=source, fault="a sparse file; pack it without --sparse")
                else:
                    yield _plan_file(source, member.size_bytes, member.read)
            archive.drain()
    except (DamagedTarError, EOFError, zlib.error, OSError) as error:
        raise FloorplanError(
            f"{path}: damaged after {members} plans ({' '.join(str(error).split())}); fetch it again"
        ) from error


def _opened(path: Path) -> BinaryIO:
    with path.open("rb") as file:
        zipped = file.read(len(_GZIP_MAGIC)) == _GZIP_MAGIC
    return cast(BinaryIO, gzip.open(path)) if zipped else path.open("rb")
