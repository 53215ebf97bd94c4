"""Images decoded from memory, silently.

libpng prints its complaints on the standard error, so a PNG's checksums are checked first; OpenCV's log is
switched off for other formats. Decoders fill in the missing part of a truncated JPEG, so `is_whole` looks for
its end.
"""

from __future__ import annotations

import re
import struct
import zlib
from collections.abc import Iterator

import cv2
import numpy as np
from cv2.utils import logging
from numpy.typing import NDArray

PNG_START, JPEG_START = b"\x89PNG\r\n\x1a\n", b"\xff\xd8"
TIFF_STARTS = b"II*\0", b"MM\0*"

# Any marker except those within coded data: stuffed zeros, restarts, fill bytes.
_JPEG_MARKER = re.compile(rb"\xff+([^\x00\xd0-\xd7\xff])")
_JPEG_END, _JPEG_BARE = 0xD9, 0x01
_JPEG_FRAMES = {*range(0xC0, 0xD0)} - {0xC4, 0xC8, 0xCC}  # of which those are tables
_TIFF_ORIENTATION = 274


def decoded(data: bytes, flags: int) -> NDArray[np.uint8 | np.uint16] | None:
    """Decode an image with `cv2.imdecode`: (H, W) or (H, W, C), or None if it cannot be decoded.

    Args:
        data: content of the file.
        flags: OpenCV's, such as `cv2.IMREAD_COLOR_RGB`.
    """
    if data.startswith(PNG_START) and not is_whole(data):
        return None
    if flags & cv2.IMREAD_IGNORE_ORIENTATION:
        data = _as_stored(data)
    level = logging.setLogLevel(logging.LOG_LEVEL_SILENT)
    try:
        pixels = cv2.imdecode(np.frombuffer(data, np.uint8), flags)
    except cv2.error:  # no bytes, or more pixels than OpenCV allows
        return None
    finally:
        logging.setLogLevel(level)
    return None if pixels is None else np.asarray(pixels)


def is_whole(data: bytes) -> bool:
    """Whether a PNG or JPEG is complete; more bytes may follow. True for other formats."""
    if data.startswith(JPEG_START):
        return any(kind == _JPEG_END for kind, _ in _jpeg_segments(data))
    return is_whole_png(data) if data.startswith(PNG_START) else True


def is_whole_png(data: bytes) -> bool:
    """Whether these bytes are a PNG, complete and with correct checksums; more bytes may follow."""
    if not data.startswith(PNG_START):
        return False
    at, view = len(PNG_START), memoryview(data)
    while at + 12 <= len(data):
        length, name = struct.unpack_from(">I4s", data, at)
        end = at + 8 + length
        if end + 4 > len(data) or zlib.crc32(view[at + 4 : end]) != struct.unpack_from(">I", data, end)[0]:
            return False
        if name == b"IEND":
            return True
        at = end + 4
    return False


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


def _as_stored(data: bytes) -> bytes:
    """A TIFF without its orientation, by which OpenCV turns it whatever the flags are; or the data."""
    if not data.startswith(TIFF_STARTS):
        return data
    order = "<" if data.startswith(b"II") else ">"
    stored = bytearray(data)
    try:
        (start,) = struct.unpack_from(f"{order}I", data, 4)
        (count,) = struct.unpack_from(f"{order}H", data, start)
        for entry in range(start + 2, start + 2 + 12 * count, 12):
            if struct.unpack_from(f"{order}H", data, entry) == (_TIFF_ORIENTATION,):
                struct.pack_into(f"{order}H", stored, entry + 8, 1)
    except struct.error:  # cut short, which the decoder finds too
        return data
    return bytes(stored)
