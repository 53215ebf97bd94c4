"""PGM images, plain (P2) and binary (P5), of 8 and 16 bits.

Read here and not by OpenCV, which scales other maxima than 255 its own way, and says on the standard error
what it finds wrong.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from rendezvous.errors import MapError

MAX_PIXELS = 100_000_000
"""Largest image of a map, in any format: 10,000 x 10,000 pixels, 500 m x 500 m at 0.05 m."""

Grey = NDArray[np.uint8 | np.uint16]

# Magic, width, height, maximum: each after white space and comments. One white space ends the header.
_GAP = rb"(?:\s|#[^\n\r]*[\n\r])+"
_HEADER = re.compile(
    rb"(P[25])" + _GAP + rb"(\d{1,9})" + _GAP + rb"(\d{1,9})" + _GAP + rb"(\d{1,9})(?:#[^\n\r]*)?\s"
)


def read_pgm(data: bytes, source: Path) -> tuple[Grey, int]:
    """(H, W) grey values as stored, top row first, and the value of white.

    Raises:
        MapError: names the source and what is wrong with it.
    """
    header = _HEADER.match(data)
    if header is None:
        raise MapError(f"{source}: is no PGM: its header lacks width, height or maximum after {data[:2]!r}")
    width, height, white = (int(value) for value in header.groups()[1:])
    require_size(width, height, source)
    if not 0 < white < 65536:
        raise MapError(f"{source}: PGM with maximum {white}; must be from 1 to 65535")
    body = data[header.end() :]
    grey = _plain(body, source) if header[1] == b"P2" else _binary(body, white, width * height)
    if grey.size < width * height:
        raise MapError(
            f"{source}: PGM is cut off: {grey.size:,} of {width} x {height} = {width * height:,} pixels"
        )
    grey = grey[: width * height].reshape(height, width)
    if int(grey.max()) > white:
        raise MapError(f"{source}: PGM holds grey {int(grey.max())}; its maximum is {white}")
    return grey.astype(np.uint8 if white < 256 else np.uint16, copy=False), white


def require_size(width: int, height: int, source: Path) -> None:
    """Check an image's size before memory is taken for it.

    Raises:
        MapError: nothing in it, or more than `MAX_PIXELS`.
    """
    if not 0 < width * height <= MAX_PIXELS:
        raise MapError(
            f"{source}: image of {width} x {height} pixels; must be at least 1 and at most {MAX_PIXELS:,}"
        )


def _binary(body: bytes, white: int, count: int) -> NDArray[np.uint8 | np.uint16]:
    if white < 256:
        return np.frombuffer(body, np.uint8, min(count, len(body)))
    return np.frombuffer(body, ">u2", min(count, len(body) // 2))


def _plain(body: bytes, source: Path) -> NDArray[np.uint32]:
    values = re.sub(rb"#[^\n\r]*", b"", body)
    if re.search(rb"[^\d\s]|\d{6}", values):
        raise MapError(f"{source}: plain PGM (P2) with something else than numbers up to 65535")
    return np.array(values.split(), dtype="S5").astype(np.uint32)
