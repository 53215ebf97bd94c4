"""Bytes of images as arrays, without what decoders print of their own.

libpng prints what it finds wrong with a PNG on the standard error, so its checksums are looked at first; so
does OpenCV for other formats, unless it is told not to. Of a JPEG that is cut short the decoder makes up the
rest, so that is looked at as well.
"""

from __future__ import annotations

import re
import struct
import zlib

import cv2
import numpy as np
from cv2.utils import logging
from numpy.typing import NDArray

PNG_START, JPEG_START = b"\x89PNG\r\n\x1a\n", b"\xff\xd8"

# A marker other than those inside of the coded data: a stuffed zero, restarts, fill bytes.
_JPEG_MARKER = re.compile(rb"\xff+([^\x00\xd0-\xd7\xff])")
_JPEG_END, _JPEG_BARE = 0xD9, 0x01


def decoded(data: bytes, flags: int) -> NDArray[np.uint8 | np.uint16] | None:
    """(H, W) or (H, W, C) as `cv2.imdecode` gives it; None for what it cannot read.

    Args:
        data: a file's bytes.
        flags: of OpenCV, as `cv2.IMREAD_COLOR_RGB`.
    """
    if data.startswith(PNG_START) and not is_whole(data):
        return None
    level = logging.setLogLevel(logging.LOG_LEVEL_SILENT)
    try:
        pixels = cv2.imdecode(np.frombuffer(data, np.uint8), flags)
    except cv2.error:  # for no bytes at all, and for more pixels than OpenCV allows
        return None
    finally:
        logging.setLogLevel(level)
    return None if pixels is None else np.asarray(pixels)


def is_whole(data: bytes) -> bool:
    """Whether a PNG or JPEG reaches its end, whatever follows it; True for other formats."""
    if data.startswith(JPEG_START):
        return _is_whole_jpeg(data)
    return is_whole_png(data) if data.startswith(PNG_START) else True


def is_whole_png(data: bytes) -> bool:
    """Whether a PNG reaches its end, every chunk as it was written by its checksum; False for other files."""
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


def _is_whole_jpeg(data: bytes) -> bool:
    """Goes from segment to segment, as a thumbnail within one has an end of its own (ITU T.81, B.1)."""
    at = len(JPEG_START)
    while marker := _JPEG_MARKER.search(data, at):
        at, kind = marker.end(), marker[1][0]
        if kind == _JPEG_END:
            return True
        if kind != _JPEG_BARE and at + 2 <= len(data):
            at += int.from_bytes(data[at : at + 2], "big")
    return False
