"""The image of a ROS map: grey PGM, PNG or BMP, with or without transparency.

map_server averages the channels of a coloured image. A coloured image is far more likely to be the wrong file
than a map, so here it is an error; one that is grey in all three channels is read.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from rendezvous.errors import MapError
from rendezvous.interop.decoding import PNG_START, decoded, is_whole_png
from rendezvous.interop.given_file import given_bytes
from rendezvous.interop.pgm import Grey, read_pgm, require_size


@dataclass(frozen=True, slots=True, kw_only=True)
class MapImage:
    """An image as it is stored, top row first.

    Attributes:
        grey: (H, W) uint8 or uint16.
        alpha: (H, W), `white` where opaque; None for an image without transparency.
        white: the value of white, and of opaque.
    """

    grey: Grey
    alpha: Grey | None
    white: int


def read_map_image(path: Path) -> MapImage:
    """Reads an image; nothing is allocated for one that is larger than `MAX_PIXELS`.

    Raises:
        MapError: names the file, and what is wrong with it.
    """
    try:
        data = given_bytes(path)
    except OSError as error:
        raise MapError(f"{path}: image cannot be read ({error.strerror}); must be PGM, PNG or BMP") from error
    if data[:2] in (b"P2", b"P5"):
        grey, white = read_pgm(data, path)
        return MapImage(grey=grey, alpha=None, white=white)
    width, height, whole = _announced(data, path)
    require_size(width, height, path)
    pixels = decoded(data, cv2.IMREAD_UNCHANGED) if whole else None
    if pixels is None:
        raise MapError(f"{path}: {len(data):,} bytes of a damaged or cut off image; save or copy it again")
    return _grey(pixels, path)


def _announced(data: bytes, path: Path) -> tuple[int, int, bool]:
    """Width and height by the header of a PNG or BMP, and whether the file goes on to its end."""
    if data.startswith(PNG_START) and len(data) > 32:
        width, height = struct.unpack(">II", data[16:24])
        return width, height, is_whole_png(data)
    if data.startswith(b"BM") and len(data) > 32:
        (size,) = struct.unpack("<I", data[2:6])
        width, height = struct.unpack("<ii", data[18:26])
        return width, abs(height), len(data) >= size
    raise MapError(f"{path}: {len(data):,} bytes that are no PGM (P2, P5), PNG or BMP image")


def _grey(pixels: Grey, path: Path) -> MapImage:
    white = int(np.iinfo(pixels.dtype).max)
    if pixels.ndim == 2:
        return MapImage(grey=pixels, alpha=None, white=white)
    grey = pixels[..., 0]
    if (pixels[..., 1] != grey).any() or (pixels[..., 2] != grey).any():
        raise MapError(f"{path}: is a coloured image; a map is grey")
    alpha = pixels[..., 3] if pixels.shape[2] == 4 else None
    return MapImage(grey=grey, alpha=alpha, white=white)
