"""HouseExpo's JSON files on disk: one file, a folder of them, or the dataset's `json.tar.gz` as a stream.

Suffixes may be written in capitals, as Windows programs do.
"""

from __future__ import annotations

import gzip
import io
import json
import tarfile
import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from rendezvous.errors import ConfigError, FloorplanError
from rendezvous.resources import located

LARGEST_PLAN_BYTES = 16_000_000  # larger files are not read; HouseExpo's largest plan has 0.2 MB

_GZIP_MAGIC = b"\x1f\x8b"
_CHUNK_BYTES = 1 << 20


class _Header(tarfile.TarInfo):
    """A member's header in an archive that must be whole.

    `tarfile` takes a damaged header, or the end of the file, for the end of the archive.
    """

    @classmethod
    def fromtarfile(cls, archive: tarfile.TarFile) -> _Header:
        try:
            return super().fromtarfile(archive)
        except tarfile.EOFHeaderError:  # type: ignore[attr-defined]  # the block that ends an archive
            raise
        except tarfile.HeaderError as error:
            raise tarfile.ReadError(f"no member and no end of the archive: {error}") from error


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
    if not path.exists():
        raise ConfigError(
            f"floorplans.sources: {source!r} not found; must be a HouseExpo JSON file, a folder of them or a "
            "json.tar.gz, relative to where the command runs"
        )
    if path.is_file() and not (_is_archive(path) or _is_plan(path.name)):
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
    try:
        value = json.loads(content)
        json.dumps(value, ensure_ascii=False).encode()
    except UnicodeEncodeError as error:
        raise FloorplanError(
            f"{source}: text with {error.object[error.start]!a}, half a character; must be Unicode"
        ) from error
    except (ValueError, RecursionError) as error:
        raise FloorplanError(f"{source}: not JSON ({error}); must be one floor plan") from error
    return value


def _is_archive(path: Path) -> bool:
    return path.name.lower().endswith((".tar", ".tar.gz", ".tgz"))


def _is_plan(name: str) -> bool:
    return name.lower().endswith((".json", ".json.gz"))


def _listed(path: Path) -> list[Path]:
    return sorted(p for p in path.rglob("*") if _is_plan(p.name)) if path.is_dir() else [path]


def _read(path: Path) -> PlanFile:
    try:
        return _plan_file(str(path), path.stat().st_size, path.read_bytes)
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
        with _opened(path) as stream, tarfile.open(fileobj=stream, mode="r|", tarinfo=_Header) as archive:
            for member in archive:
                archive.members = []  # type: ignore[attr-defined]  # or it keeps all 35,126 of them
                name = member.name.rpartition("/")[2]
                if not member.isfile() or not _is_plan(name) or name.startswith("._"):
                    continue
                members += 1
                extracted = archive.extractfile(member)
                assert extracted is not None, "a regular file has content"
                yield _plan_file(f"{path}:{member.name}", member.size, extracted.read)
            while stream.read(_CHUNK_BYTES):
                pass  # gzip compares its checksum when it comes to its end
    except (tarfile.TarError, EOFError, zlib.error, OSError) as error:
        raise FloorplanError(
            f"{path}: damaged after {members} plans ({' '.join(str(error).split())}); fetch it again"
        ) from error


def _opened(path: Path) -> io.BufferedIOBase:
    with path.open("rb") as file:
        zipped = file.read(len(_GZIP_MAGIC)) == _GZIP_MAGIC
    return gzip.open(path) if zipped else path.open("rb")
