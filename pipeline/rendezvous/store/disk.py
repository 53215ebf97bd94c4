"""Files in a folder on a local disk or in object storage, each written completely or not at all.

Locally: a temporary name in the same folder, fsync, rename, fsync of the folder. In object storage an object
appears when its stream is closed.
"""

from __future__ import annotations

import errno
import hashlib
import os
import re
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from pathlib import PurePosixPath

import pyarrow as pa
import pyarrow.fs

from rendezvous.errors import StoreError

TEMPORARY_PATTERN = re.compile(r".*\.tmp-[0-9]+")
_CHUNK_BYTES = 1 << 22


@dataclass(frozen=True)
class Disk:
    """One folder. Names of files are relative to it and may contain slashes."""

    root: str  # a local path, or a URI with `://` (s3://bucket/data, gs://..., file:///...)

    @property
    def is_uri(self) -> bool:
        return "://" in self.root

    @cached_property
    def _resolved(self) -> tuple[pyarrow.fs.FileSystem, str]:
        if "\0" in self.root or self.root.encode(errors="ignore").decode() != self.root:
            encoding = sys.getfilesystemencoding()
            remedy = "" if encoding == "utf-8" else f"; names are taken for {encoding}: PYTHONUTF8=1 helps"
            raise StoreError(
                f"{self.root!r}: is not UTF-8; must name a folder in it, without zero bytes{remedy}"
            )
        if not self.is_uri:
            return pyarrow.fs.LocalFileSystem(), os.path.abspath(self.root)
        try:
            filesystem, path = pyarrow.fs.FileSystem.from_uri(self.root)
        except (pa.ArrowInvalid, OSError) as error:
            raise StoreError(f"{self.root}: cannot be opened ({_one_line(error)})") from error
        return filesystem, path

    @property
    def filesystem(self) -> pyarrow.fs.FileSystem:
        return self._resolved[0]

    def path(self, name: str = "") -> str:
        """The name's path within `filesystem`."""
        return str(PurePosixPath(self._resolved[1], name))

    def shown(self, name: str = "") -> str:
        """The file's path for messages."""
        return f"{self.root.rstrip('/')}/{name}" if name else self.root

    def names(self) -> list[str]:
        """All files in and below the folder, sorted; [] if there is no folder."""
        selector = pyarrow.fs.FileSelector(self.path(), recursive=True, allow_not_found=True)
        with self._explained(""):
            return sorted(
                str(PurePosixPath(info.path).relative_to(self.path()))
                for info in self.filesystem.get_file_info(selector)
                if info.type == pyarrow.fs.FileType.File
            )

    def size(self, name: str) -> int | None:
        """Size of a file [bytes]; None if it is missing."""
        with self._explained(name):
            info = self.filesystem.get_file_info(self.path(name))
        return int(info.size) if info.type == pyarrow.fs.FileType.File else None

    def sha256(self, name: str) -> str:
        h = hashlib.sha256()
        with self._explained(name), self.filesystem.open_input_stream(self.path(name)) as source:
            while chunk := source.read(_CHUNK_BYTES):
                h.update(chunk)
        return h.hexdigest()

    def read(self, name: str) -> bytes:
        with self._explained(name), self.filesystem.open_input_stream(self.path(name)) as source:
            return bytes(source.readall())

    def write(self, name: str, data: bytes | pa.Buffer) -> None:
        """Write a file completely, or leave nothing behind.

        Raises:
            StoreError: the disk is full or cannot be written.
        """
        with self._explained(name):
            if self.is_uri:
                self._make_parent(name)
                with self.filesystem.open_output_stream(self.path(name)) as sink:
                    sink.write(data)
            else:
                _write_and_rename(self.path(name), data)

    def move(self, name: str, new_name: str) -> None:
        with self._explained(name):
            self._make_parent(new_name)
            self.filesystem.move(self.path(name), self.path(new_name))

    def remove(self, name: str) -> None:
        with self._explained(name):
            self.filesystem.delete_file(self.path(name))

    def _make_parent(self, name: str) -> None:
        if self.filesystem.type_name == "local":  # object storage has no folders to make
            self.filesystem.create_dir(str(PurePosixPath(self.path(name)).parent))

    @contextmanager
    def _explained(self, name: str) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            raise StoreError(f"{self.shown(name)}: {_explanation(error)}") from error
        except UnicodeError as error:
            raise StoreError(f"{self.shown(name)!r}: a name in it is not UTF-8; rename it") from error


def _write_and_rename(path: str, data: bytes | pa.Buffer) -> None:
    folder = os.path.dirname(path)
    os.makedirs(folder, exist_ok=True)
    # With the process id, because a worker may outlive its run and meet the next one.
    temporary = f"{path}.tmp-{os.getpid()}"
    try:
        with open(temporary, "wb") as sink:
            sink.write(data)
            sink.flush()
            os.fsync(sink.fileno())
        os.replace(temporary, path)
    except BaseException:
        if os.path.exists(temporary):
            os.remove(temporary)
        raise
    _fsync_folder(folder)


def _fsync_folder(folder: str) -> None:
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def _explanation(error: OSError) -> str:
    if error.errno in (errno.ENOSPC, errno.EDQUOT):
        return "the disk is full; finished shards are kept: free some space and run the same command again"
    return error.strerror.lower() if error.strerror and error.errno else _one_line(error)


def _one_line(error: Exception) -> str:
    return " ".join(str(error).split())
