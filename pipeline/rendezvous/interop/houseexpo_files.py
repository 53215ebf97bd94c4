"""HouseExpo's JSON files on disk: one file, a folder of them, or the dataset's `json.tar.gz` as a stream."""

from __future__ import annotations

import gzip
import io
import tarfile
import zlib
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

from rendezvous.errors import ConfigError, FloorplanError
from rendezvous.resources import located

LARGEST_PLAN_BYTES = 16_000_000
"""HouseExpo's largest plan has 0.2 MB; what is larger than this is not read into memory."""

_GZIP_MAGIC = b"\x1f\x8b"
_CHUNK_BYTES = 1 << 20


class _Header(tarfile.TarInfo):
    """A member's header, of an archive that must be whole.

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
    """One file as it was found.

    Attributes:
        source: where it was: a path, or `archive.tar.gz:member`.
        content: its bytes, not yet parsed.
        fault: why it could not be read, empty if it could.
    """

    source: str
    content: bytes = b""
    fault: str = ""


def check_source(source: str) -> None:
    """See that a source can be read at all.

    Raises:
        ConfigError: there is no such file or folder, or it is of another kind.
    """
    path = located(source)
    if not path.exists():
        raise ConfigError(
            f"floorplans.sources: {source!r} not found; must be a HouseExpo JSON file, a folder of them or a "
            "json.tar.gz, relative to where the command runs"
        )
    if path.is_file() and not (_is_archive(path) or path.suffix == ".json"):
        raise ConfigError(f"floorplans.sources: {source!r}; must end in .json, .tar, .tar.gz or .tgz")


def count_plan_files(source: str) -> int | None:
    """How many files a source holds; None for an archive, which would have to be read for it."""
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
        yield replace(file, source=f"{Path(source)}{file.source.removeprefix(str(path))}")


def _is_archive(path: Path) -> bool:
    return path.name.endswith((".tar", ".tar.gz", ".tgz"))


def _listed(path: Path) -> list[Path]:
    return sorted(path.rglob("*.json")) if path.is_dir() else [path]


def _read(path: Path) -> PlanFile:
    try:
        if (size_bytes := path.stat().st_size) > LARGEST_PLAN_BYTES:
            return PlanFile(source=str(path), fault=_too_large(size_bytes))
        return PlanFile(source=str(path), content=path.read_bytes())
    except OSError as error:
        return PlanFile(source=str(path), fault=(error.strerror or str(error)).lower())


def _archived(path: Path) -> Iterator[PlanFile]:
    members = 0
    try:
        with _opened(path) as stream, tarfile.open(fileobj=stream, mode="r|", tarinfo=_Header) as archive:
            for member in archive:
                archive.members = []  # type: ignore[attr-defined]  # or it keeps all 35,126 of them
                name = member.name.rpartition("/")[2]
                if not member.isfile() or not name.endswith(".json") or name.startswith("._"):
                    continue
                source = f"{path}:{member.name}"
                members += 1
                if member.size > LARGEST_PLAN_BYTES:
                    yield PlanFile(source=source, fault=_too_large(member.size))
                    continue
                extracted = archive.extractfile(member)
                assert extracted is not None, "a regular file has content"
                yield PlanFile(source=source, content=extracted.read())
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


def _too_large(size_bytes: int) -> str:
    return f"{size_bytes} bytes; a floor plan has at most {LARGEST_PLAN_BYTES}: is it one?"
