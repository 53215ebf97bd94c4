"""Bytes of images as arrays, without what decoders print of their own.

libpng says on the standard error what it finds wrong with a PNG, so its checksums are looked at first; OpenCV
does for other formats, unless it is told not to.
"""

from __future__ import annotations

import struct
import zlib

import cv2
import numpy as np
from cv2.utils import logging
from numpy.typing import NDArray

PNG_START = b"\x89PNG\r\n\x1a\n"


def decoded(data: bytes, flags: int) -> NDArray[np.uint8 | np.uint16] | None:
    """(H, W) or (H, W, C) as `cv2.imdecode` gives it; None for what it cannot read.

    Args:
        data: a file's bytes.
        flags: of OpenCV, as `cv2.IMREAD_COLOR_RGB`.
    """
    if data.startswith(PNG_START) and not is_whole_png(data):
        return None
    level = logging.setLogLevel(logging.LOG_LEVEL_SILENT)
    try:
        pixels = cv2.imdecode(np.frombuffer(data, np.uint8), flags)
    except cv2.error:  # for no bytes at all, and for more pixels than OpenCV allows
        return None
    finally:
        logging.setLogLevel(level)
    return None if pixels is None else np.asarray(pixels)


def is_whole_png(data: bytes) -> bool:
    """Whether a PNG goes on to its end, every chunk as it was written, by its checksum."""
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
