"""Images decoded from memory, silently.

libpng prints its complaints on the standard error, so a PNG's checksums are checked first; OpenCV's log is
switched off for other formats. Decoders fill in the missing part of a truncated JPEG, so `is_whole` looks for
its end.
"""

from __future__ import annotations

import struct

import cv2
import numpy as np
from cv2.utils import logging
from numpy.typing import NDArray

from rendezvous.interop.image_header import PNG_START, TIFF_STARTS, image_end, image_header

_TIFF_ORIENTATION = 274


def decoded(data: bytes, flags: int) -> NDArray[np.uint8 | np.uint16] | None:
    """Decode an image with `cv2.imdecode`: (H, W) or (H, W, C), or None if it cannot be decoded.

    Args:
        data: content of a PNG, JPEG, BMP, TIFF, WebP or PNM of at most `MAX_PIXELS`.
        flags: OpenCV's, such as `cv2.IMREAD_COLOR_RGB`.
    """
    header = image_header(data)
    if header is None or not header.fits or (data.startswith(PNG_START) and not is_whole(data)):
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
    return image_end(data) is not None


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
