"""The size of an image from its header, and where it ends, before memory is taken for its pixels."""

from __future__ import annotations

import re
import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass

MAX_PIXELS = 100_000_000
"""Of an image: 10,000 x 10,000, a map of 500 m x 500 m at 0.05 m or a phone's largest picture."""

PNG_START, JPEG_START = b"\x89PNG\r\n\x1a\n", b"\xff\xd8"
TIFF_STARTS = b"II*\0", b"MM\0*"

# Any marker except those within coded data: stuffed zeros, restarts, fill bytes.
_JPEG_MARKER = re.compile(rb"\xff+([^\x00\xd0-\xd7\xff])")
_JPEG_END, _JPEG_BARE = 0xD9, 0x01
_JPEG_FRAMES = {*range(0xC0, 0xD0)} - {0xC4, 0xC8, 0xCC}  # of which those are tables
_PNM = re.compile(rb"P[1-6]" + 2 * rb"(?:\s|#[^\n\r]*[\n\r])+(\d{1,9})" + rb"(?=[\s#])")
_TIFF_WIDTH, _TIFF_HEIGHT = 256, 257
_TIFF_FORMATS = {3: "H", 4: "I"}


@dataclass(frozen=True, slots=True)
class ImageHeader:
    """What an image says of itself."""

    width: int
    height: int
    pixel_bytes: int = 3  # of the decoded image, at most

    @property
    def fits(self) -> bool:
        """Whether there are pixels, and no more than `MAX_PIXELS`."""
        return self.width > 0 and 0 < self.width * self.height <= MAX_PIXELS


def image_header(data: bytes) -> ImageHeader | None:
    """The header of a PNG, JPEG, BMP, TIFF, WebP or PNM; None for another file or half a header."""
    try:
        if data.startswith(PNG_START):
            return _png(data)
        if data.startswith(JPEG_START):
            return ImageHeader(*jpeg_size(data))
        if data.startswith(b"BM"):
            return _bmp(data)
        if data.startswith(TIFF_STARTS):
            return _tiff(data)
        if data.startswith(b"RIFF") and data[8:12] == b"WEBP":
            return _webp(data)
        found = _PNM.match(data)
        return ImageHeader(int(found[1]), int(found[2])) if found else None
    except (struct.error, KeyError):
        return None


def image_end(data: bytes) -> int | None:
    """Where a PNG or JPEG ends; None if it is cut short or a PNG is damaged; all bytes of another format."""
    if data.startswith(JPEG_START):
        return next((at for kind, at in _jpeg_segments(data) if kind == _JPEG_END), None)
    return _png_end(data) if data.startswith(PNG_START) else len(data)


def jpeg_size(data: bytes) -> tuple[int, int]:
    """Width and height from the header of a JPEG; 0, 0 if it has none."""
    for kind, at in _jpeg_segments(data):
        if kind in _JPEG_FRAMES and at + 7 <= len(data):
            height, width = struct.unpack_from(">HH", data, at + 3)
            return width, height
    return 0, 0


def _jpeg_segments(data: bytes) -> Iterator[tuple[int, int]]:
    """The kind of each marker and where its content starts (ITU T.81, B.1).

    Content is skipped, as a thumbnail inside it has markers of its own.
    """
    at = len(JPEG_START)
    while marker := _JPEG_MARKER.search(data, at):
        at, kind = marker.end(), marker[1][0]
        yield kind, at
        if kind not in (_JPEG_BARE, _JPEG_END) and at + 2 <= len(data):
            at += int.from_bytes(data[at : at + 2], "big")


def _png(data: bytes) -> ImageHeader:
    name, width, height, bits, colour = struct.unpack_from(">4sIIBB", data, 12)
    if name != b"IHDR":
        raise KeyError(name)
    # OpenCV gives four channels to all that is not plain grey: colours of a palette, transparency.
    return ImageHeader(width, height, (1 if colour == 0 else 4) * (2 if bits == 16 else 1))


def _png_end(data: bytes) -> int | None:
    at, view = len(PNG_START), memoryview(data)
    while at + 12 <= len(data):
        length, name = struct.unpack_from(">I4s", data, at)
        end = at + 8 + length
        if end + 4 > len(data) or zlib.crc32(view[at + 4 : end]) != struct.unpack_from(">I", data, end)[0]:
            return None
        if name == b"IEND":
            return end + 4
        at = end + 4
    return None


def _bmp(data: bytes) -> ImageHeader:
    (head,) = struct.unpack_from("<I", data, 14)
    width, height = struct.unpack_from("<HH" if head == 12 else "<ii", data, 18)
    return ImageHeader(width, abs(height), 4)


def _tiff(data: bytes) -> ImageHeader:
    order = "<" if data.startswith(b"II") else ">"
    (start,) = struct.unpack_from(f"{order}I", data, 4)
    (count,) = struct.unpack_from(f"{order}H", data, start)
    sides = {}
    for entry in range(start + 2, start + 2 + 12 * count, 12):
        tag, kind = struct.unpack_from(f"{order}HH", data, entry)
        if tag in (_TIFF_WIDTH, _TIFF_HEIGHT):
            (sides[tag],) = struct.unpack_from(order + _TIFF_FORMATS[kind], data, entry + 8)
    return ImageHeader(sides[_TIFF_WIDTH], sides[_TIFF_HEIGHT], 4)


def _webp(data: bytes) -> ImageHeader:
    kind = data[12:16]
    if kind == b"VP8 ":
        width, height = struct.unpack_from("<HH", data, 26)
        return ImageHeader(width & 0x3FFF, height & 0x3FFF)
    if kind == b"VP8L":
        (bits,) = struct.unpack_from("<I", data, 21)
        return ImageHeader((bits & 0x3FFF) + 1, (bits >> 14 & 0x3FFF) + 1, 4)
    sides = struct.unpack_from("<HBHB", data, 24)
    if kind != b"VP8X":
        raise KeyError(kind)
    return ImageHeader((sides[0] | sides[1] << 16) + 1, (sides[2] | sides[3] << 16) + 1, 4)
