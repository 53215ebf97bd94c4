"""Members of a tar archive as a stream, read within bounds.

`tarfile` believes headers: it skips 2^60 bytes block by block, keeps long names of any length in memory, and
takes a damaged header, or the end of the file, for the end of the archive. POSIX ustar and pax archives and
GNU's are read here, as `tar` and Python write them.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import BinaryIO

LONGEST_HEADER_BYTES = 65_536  # of a long name or of pax records
MOST_HEADERS = 8  # of long names and pax records before one member
MOST_SKIPPED_BYTES = 1 << 32  # of all that is not asked for, together

_BLOCK = 512
_CHUNK_BYTES = 1 << 20
_REGULAR, _CONTIGUOUS, _SPARSE = b"0\0", b"7", b"S"
_LONG_NAME, _LONG_LINK, _PAX = b"L", b"K", (b"x", b"g", b"X")
_WITHOUT_CONTENT = b"123456"  # links, devices, folders, pipes
_RECORD = re.compile(rb"(\d{1,8}) ([^=\n]{1,1000})=")


class DamagedTarError(Exception):
    """The archive cannot be read on from here."""


@dataclass(slots=True)
class Member:
    """One member; its content can be read until the next is asked for."""

    name: str  # bytes that are not UTF-8 are escaped
    size_bytes: int  # as its header says
    is_file: bool  # whether it is a regular file
    is_sparse: bool  # whether it was packed without its zeros, which is not undone here
    _tar: TarStream

    def read(self) -> bytes:
        """Its content.

        Raises:
            DamagedTarError: the archive ends before.
        """
        data = self._tar.take(self.size_bytes)
        self._tar.left_bytes -= self.size_bytes
        return data


@dataclass(slots=True)
class TarStream:
    """An archive that is read once, from its beginning to its end."""

    stream: BinaryIO
    left_bytes: int = field(default=0, init=False)  # of the current member, with its padding
    _skipped_bytes: int = field(default=0, init=False)

    def members(self) -> Iterator[Member]:
        """All members, in order, up to the block of zeros that ends the archive.

        Raises:
            DamagedTarError: a header or the end of the archive is missing, or it holds too much else.
        """
        long_name, records, headers = "", dict[bytes, bytes](), 0
        while any(header := self.take(_BLOCK)):
            _check_sum(header)
            kind, size_bytes = header[156:157], _number(header[124:136])
            if kind in (_LONG_NAME, _LONG_LINK, *_PAX):
                headers += 1
                if headers > MOST_HEADERS:
                    raise DamagedTarError(f"more than {MOST_HEADERS} names and headers before a member")
                extra = self._extra(size_bytes)
                if kind == _LONG_NAME:
                    long_name = _text(extra)
                elif kind in (b"x", b"X"):
                    records |= _pax_records(extra)
                continue
            name = _text(records[b"path"]) if b"path" in records else long_name or _name(header)
            if b"size" in records:
                size_bytes = _decimal(records[b"size"])
            stored_bytes = 0 if kind in _WITHOUT_CONTENT else size_bytes
            self.left_bytes = -(-stored_bytes // _BLOCK) * _BLOCK
            if kind == _SPARSE:
                self._skip_sparse_headers(header)
            sparse = kind == _SPARSE or any(key.startswith(b"GNU.sparse") for key in records)
            yield Member(
                name=name,
                size_bytes=stored_bytes,
                is_file=kind in _REGULAR or kind in (_CONTIGUOUS, _SPARSE),
                is_sparse=sparse,
                _tar=self,
            )
            self._skip(self.left_bytes)
            long_name, records, headers = "", {}, 0

    def drain(self) -> None:
        """Read what follows the archive's end, so that gzip compares its checksum."""
        while got := len(self.stream.read(_CHUNK_BYTES)):
            self._count(got)

    def take(self, size_bytes: int) -> bytes:
        """The next bytes of the stream, all of them."""
        data = self.stream.read(size_bytes)
        if len(data) < size_bytes:
            raise DamagedTarError("its end is missing")
        return data

    def _extra(self, size_bytes: int) -> bytes:
        if size_bytes > LONGEST_HEADER_BYTES:
            raise DamagedTarError(
                f"a name or header of {size_bytes:,} bytes; at most {LONGEST_HEADER_BYTES:,} are read"
            )
        self._count(_BLOCK + size_bytes)
        return self.take(-(-size_bytes // _BLOCK) * _BLOCK)[:size_bytes]

    def _skip_sparse_headers(self, header: bytes) -> None:
        more = header[482]
        while more:
            self._count(_BLOCK)
            more = self.take(_BLOCK)[504]

    def _skip(self, size_bytes: int) -> None:
        self._count(size_bytes)
        while size_bytes:
            size_bytes -= len(self.take(min(_CHUNK_BYTES, size_bytes)))

    def _count(self, size_bytes: int) -> None:
        self._skipped_bytes += size_bytes
        if self._skipped_bytes > MOST_SKIPPED_BYTES:
            raise DamagedTarError(f"more than {MOST_SKIPPED_BYTES:,} bytes that are no floor plans")


def _check_sum(header: bytes) -> None:
    signs = sum(header) - sum(header[148:156]) + 8 * ord(" ")
    as_signed = signs - 256 * sum(sign > 127 for sign in header[:148] + header[156:])
    if _number(header[148:156]) not in (signs, as_signed):
        raise DamagedTarError("no member and no end of the archive: bad checksum")


def _number(digits: bytes) -> int:
    """An octal number, or one of base 256 as GNU tar writes large ones."""
    if digits[0] & 0x80:
        value = int.from_bytes(digits[1:], "big")
        return value if digits[0] == 0x80 else _refused(digits)
    text = digits.split(b"\0")[0].strip()
    return int(text, 8) if re.fullmatch(rb"[0-7]+", text) else 0 if not text else _refused(digits)


def _decimal(digits: bytes) -> int:
    return int(digits) if re.fullmatch(rb"[0-9]{1,20}", digits) else _refused(digits)


def _refused(digits: bytes) -> int:
    raise DamagedTarError(f"no member and no end of the archive: {digits[:20]!r} is no size")


def _pax_records(data: bytes) -> dict[bytes, bytes]:
    """Pairs of keyword and value: `LENGTH KEYWORD=VALUE` and a line end, LENGTH for all of it."""
    records, at = dict[bytes, bytes](), 0
    while at < len(data) and data[at] != 0:
        head = _RECORD.match(data, at)
        end = at + int(head[1]) if head else 0
        if head is None or end > len(data) or data[end - 1 : end] != b"\n" or end <= head.end():
            raise DamagedTarError("no member and no end of the archive: bad pax records")
        records[head[2]] = data[head.end() : end - 1]
        at = end
    return records


def _name(header: bytes) -> str:
    name = _text(header[:100])
    prefix = _text(header[345:500]) if header[257:263] == b"ustar\0" else ""
    return f"{prefix}/{name}" if prefix else name


def _text(name: bytes) -> str:
    return name.split(b"\0")[0].decode(errors="surrogateescape")
