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
from rendezvous.interop.decoding import JPEG_START, PNG_START, decoded, is_whole, jpeg_size
from rendezvous.interop.given_file import given_bytes

MAX_PIXELS = 100_000_000  # of a map's image, in any format: 10,000 x 10,000, 500 m x 500 m at 0.05 m

Grey = NDArray[np.uint8 | np.uint16]

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
    width, height, whole = _announced(data, path)
    _require_size(width, height, path)
    pixels = decoded(data, cv2.IMREAD_UNCHANGED) if whole else None
    if pixels is None:
        raise MapError(f"{path}: {len(data):,} bytes of a damaged or cut off image; save or copy it again")
    white = int(np.iinfo(pixels.dtype).max)
    if pixels.ndim == 2:
        return MapImage(grey=pixels, alpha=None, white=white)
    grey = pixels[..., 0]
    if (pixels[..., 1:3] != grey[..., None]).any():
        raise MapError(f"{path}: is a coloured image; a map is grey")
    return MapImage(grey=grey, alpha=pixels[..., 3] if pixels.shape[2] == 4 else None, white=white)


def _announced(data: bytes, path: Path) -> tuple[int, int, bool]:
    """Width and height from the header of a PNG, BMP or JPEG, and whether the file is complete."""
    if data.startswith(PNG_START) and len(data) > 32:
        return *struct.unpack(">II", data[16:24]), is_whole(data)
    if data.startswith(b"BM") and len(data) > 32:
        (size,) = struct.unpack("<I", data[2:6])
        width, height = struct.unpack("<ii", data[18:26])
        return width, abs(height), len(data) >= size
    if data.startswith(JPEG_START):
        return *jpeg_size(data), is_whole(data)
    raise MapError(f"{path}: {len(data):,} bytes that are no PGM (P2, P5), PNG, BMP or JPEG image")


def _require_size(width: int, height: int, source: Path) -> None:
    """Check an image's size before memory is taken for it."""
    if not 0 < width * height <= MAX_PIXELS:
        raise MapError(
            f"{source}: image of {width} x {height} pixels; must be at least 1 and at most {MAX_PIXELS:,}"
        )


def _pgm(data: bytes, source: Path) -> MapImage:
    header = _HEADER.match(data)
    if header is None:
        raise MapError(f"{source}: is no PGM: its header lacks width, height or maximum after {data[:2]!r}")
    width, height, white = (int(value) for value in header.groups()[1:])
    _require_size(width, height, source)
    if not 0 < white < 65536:
        raise MapError(f"{source}: PGM with maximum {white}; must be from 1 to 65535")
    rest, count = data[header.end() :], width * height
    if header[1] == b"P2":
        found = _numbers(rest, source)
        following = found.size - count
    else:
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


def _numbers(body: bytes, source: Path) -> NDArray[np.uint32]:
    """The pixels of a plain PGM."""
    values = re.sub(rb"#[^\n\r]*", b"", body)
    if re.search(rb"[^\d\s]|\d{6}", values):
        raise MapError(f"{source}: plain PGM (P2) with something else than numbers up to 65535")
    return np.array(values.split(), dtype="S5").astype(np.uint32)
