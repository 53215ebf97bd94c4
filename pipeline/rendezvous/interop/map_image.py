"""Images of ROS maps: grey PGM, PNG, BMP or JPEG, with or without transparency.

map_server averages the channels of a coloured image. A coloured image is far more likely to be the wrong file
than a map, so here it is an error; one that is grey in all three channels is read.

PGM files, plain (P2) and binary (P5), are read here and not by OpenCV, which scales maxima other than 255 in
its own way and prints its complaints.
"""

from __future__ import annotations

import re
import struct
import warnings
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from rendezvous.errors import MapError
from rendezvous.interop.decoding import decoded
from rendezvous.interop.given_file import given_bytes
from rendezvous.interop.image_header import (
    JPEG_START,
    MAX_PIXELS,
    PNG_START,
    ImageHeader,
    image_end,
    image_header,
)

MAX_BYTES = 2 * MAX_PIXELS  # of the decoded image, whose pixels have one to eight

Grey = NDArray[np.uint8 | np.uint16]

_PIECE_BYTES = 1 << 20  # of a plain PGM, parsed at a time
_LINE_END, _SPACE = re.compile(rb"[\n\r]"), re.compile(rb"\s")
_SHORTEST_BYTES = 12  # of a JPEG's start and the beginning of its frame

# White space and comments between the magic, the width, the height and the maximum.
_GAP = rb"(?:\s|#[^\n\r]*[\n\r])+"
_HEADER = re.compile(rb"(P[25])" + 3 * (_GAP + rb"(\d{1,9})") + rb"(?=[\s#])")

# White space, a rest of the line, a line and comments.
_HEADER_ENDS = rb"(?:#[^\n\r]*)?\s", rb"[ \t]*(?:#[^\n\r]*)?\r?\n", rb"\s(?:#[^\n\r]*\r?\n)+"


@dataclass(frozen=True, slots=True, kw_only=True)
class MapImage:
    """The stored values of an image, top row first."""

    grey: Grey  # (H, W) uint8 or uint16
    alpha: Grey | None  # (H, W), `white` where opaque; None without an alpha channel
    white: int  # the value of white and of opaque


def read_map_image(path: Path) -> MapImage:
    """Read an image; no memory is allocated for one larger than `MAX_PIXELS`.

    Raises:
        MapError: names the file and what is wrong with it.

    Warns:
        UserWarning: bytes follow the last pixel.
    """
    try:
        data = given_bytes(path)
    except OSError as error:
        raise MapError(
            f"{path}: image cannot be read ({error.strerror}); must be PGM, PNG, BMP or JPEG"
        ) from error
    if data[:2] in (b"P2", b"P5"):
        return _pgm(data, path)
    header, end = _announced(data, path)
    _require_size(header, path)
    pixels = decoded(data, cv2.IMREAD_UNCHANGED) if end is not None else None
    if pixels is None or end is None:
        raise MapError(f"{path}: {len(data):,} bytes of a damaged or cut off image; save or copy it again")
    if len(data) > end:
        warnings.warn(
            f"{path}: {len(data) - end:,} bytes after the end of the image are left out", stacklevel=3
        )
    white = int(np.iinfo(pixels.dtype).max)
    if pixels.ndim == 2:
        return MapImage(grey=pixels, alpha=None, white=white)
    grey = pixels[..., 0]
    if (pixels[..., 1:3] != grey[..., None]).any():
        raise MapError(f"{path}: is a coloured image; a map is grey")
    return MapImage(grey=grey, alpha=pixels[..., 3] if pixels.shape[2] == 4 else None, white=white)


def _announced(data: bytes, path: Path) -> tuple[ImageHeader, int | None]:
    """The header of a PNG, BMP or JPEG, and where the image ends; None if the file is not complete."""
    known = (PNG_START, b"BM", JPEG_START)
    header = image_header(data) if data.startswith(known) and len(data) >= _SHORTEST_BYTES else None
    if header is None:
        raise MapError(f"{path}: {len(data):,} bytes that are no PGM (P2, P5), PNG, BMP or JPEG image")
    if not data.startswith(b"BM"):
        return header, image_end(data)
    (size,) = struct.unpack_from("<I", data, 2)
    return header, size if len(data) >= size else None


def _require_size(header: ImageHeader, source: Path) -> None:
    """Check an image's size before memory is taken for it."""
    width, height = header.width, header.height
    if not header.fits:
        raise MapError(
            f"{source}: image of {width} x {height} pixels; must be at least 1 and at most {MAX_PIXELS:,}"
        )
    if width * height * header.pixel_bytes > MAX_BYTES:
        raise MapError(
            f"{source}: image of {width} x {height} pixels of {header.pixel_bytes} bytes; at most "
            f"{MAX_BYTES:,} bytes are read: save it in grey"
        )


def _pgm(data: bytes, source: Path) -> MapImage:
    header = _HEADER.match(data)
    if header is None:
        raise MapError(f"{source}: is no PGM: its header lacks width, height or maximum after {data[:2]!r}")
    width, height, white = (int(value) for value in header.groups()[1:])
    _require_size(ImageHeader(width, height, 1 if white < 256 else 2), source)
    if not 0 < white < 65536:
        raise MapError(f"{source}: PGM with maximum {white}; must be from 1 to 65535")
    count = width * height
    if header[1] == b"P2":
        found, following = _numbers(data, header.end(), count, source)
    else:
        rest = data[header.end() :]
        pixel = np.dtype(np.uint8 if white < 256 else ">u2")
        raster = _raster(rest, count * pixel.itemsize, crlf=b"\r\n" in header[0])
        found = np.frombuffer(raster, pixel, len(raster) // pixel.itemsize)
        following = len(raster) - count * pixel.itemsize
    if found.size < count:
        raise MapError(f"{source}: PGM is cut off: {found.size:,} of {width} x {height} = {count:,} pixels")
    if following > 0:
        what = "numbers" if header[1] == b"P2" else "bytes"
        warnings.warn(
            f"{source}: {following:,} {what} after the last of {width} x {height} pixels are left out; is "
            "the size in its header right?",
            stacklevel=4,
        )
    grey = found[:count].reshape(height, width)
    if int(grey.max()) > white:
        raise MapError(f"{source}: PGM holds grey {int(grey.max())}; its maximum is {white}")
    return MapImage(
        grey=grey.astype(np.uint8 if white < 256 else np.uint16, copy=False), alpha=None, white=white
    )


def _raster(rest: bytes, size_bytes: int, *, crlf: bool) -> bytes:
    """The pixels of a binary PGM, after the single white space that ends its header.

    Some programs write more white space or a comment there, or a line end after the pixels; the size gives
    this away. CRLF may come from a text conversion such as git's, which may have changed the pixels too.
    """
    extra = len(rest) - size_bytes
    starts: tuple[int, ...]
    if crlf and rest.startswith(b"\r\n"):
        undone = rest[2:].replace(b"\r\n", b"\n")
        starts, rest = (2,), rest if len(undone) != size_bytes else b"\r\n" + undone
    elif extra > 0 and re.fullmatch(_GAP, rest[:extra]):
        starts = (extra,)
    else:
        ends = (re.match(end, rest) for end in _HEADER_ENDS)
        starts = tuple(end.end() for end in ends if end)
    for start in starts:
        if rest[start + size_bytes :].isspace():
            return rest[start : start + size_bytes]
    return rest[starts[0] :]


def _numbers(data: bytes, start: int, count: int, source: Path) -> tuple[NDArray[np.uint32], int]:
    """The pixels of a plain PGM, at most `count`, and how many numbers follow them.

    They are read in pieces that end between two lines, or two numbers outside of a comment.
    """
    pieces, found, at = [np.empty(0, np.uint32)], 0, start
    while at < len(data):
        end = _piece_end(data, at)
        values = re.sub(rb"#[^\n\r]*", b"", data[at:end])
        if re.search(rb"[^\d\s]|\d{6}", values):
            raise MapError(f"{source}: plain PGM (P2) with something else than numbers up to 65535")
        words = values.split()
        if found < count:
            pieces.append(np.array(words[: count - found], dtype="S5").astype(np.uint32))
        found, at = found + len(words), end
    return np.concatenate(pieces), found - count


def _piece_end(data: bytes, at: int) -> int:
    """The end of a piece that begins at `at`: that of a line, or else that of a number."""
    if len(data) - at <= _PIECE_BYTES:
        return len(data)
    for ends in (b"\n", b"\r"):
        if (end := data.rfind(ends, at, at + _PIECE_BYTES)) >= 0:
            return end + 1
    if (comment := data.find(b"#", at, at + _PIECE_BYTES)) >= 0:
        after = _LINE_END.search(data, comment)
        return after.end() if after else len(data)
    after = _SPACE.search(data, at + _PIECE_BYTES)
    return after.end() if after else len(data)
