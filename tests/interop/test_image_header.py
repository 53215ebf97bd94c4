"""Images are measured before they are decoded, in every format that is read."""

from __future__ import annotations

import os
import struct
import tracemalloc
import zlib
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rendezvous.commands.fuse.inputs import read_photograph
from rendezvous.errors import CameraError, ConfigError, MapError
from rendezvous.geometry.camera import PinholeCamera
from rendezvous.interop.camera_info import CameraInfo
from rendezvous.interop.decoding import decoded
from rendezvous.interop.image_header import MAX_PIXELS, ImageHeader, image_end, image_header
from rendezvous.interop.map_image import read_map_image
from rendezvous.stages.dataset.photos import photo_folder

FORMATS = (".png", ".jpg", ".bmp", ".tiff", ".webp", ".ppm", ".pgm")
CAMERA = CameraInfo(
    camera=PinholeCamera(fx_px=600.0, fy_px=600.0, cx_px=319.5, cy_px=239.5, width_px=640, height_px=480),
    distortion_model="plumb_bob",
    distortion=(),
)
MOST_BYTES = 50_000_000
SIDE = 20_000


def encoded(suffix: str, height: int, width: int, *options: int) -> bytes:
    shape = (height, width) if suffix == ".pgm" else (height, width, 3)
    pixels = np.random.default_rng(0).integers(0, 256, shape, np.uint8)
    return cv2.imencode(suffix, pixels, list(options))[1].tobytes()


def png_of(width: int, height: int, *, bits: int = 8, colour: int = 2, rows: int | None = None) -> bytes:
    """A PNG of zeros: some kB for a GB of pixels; all its rows unless told otherwise."""

    def chunk(name: bytes, content: bytes) -> bytes:
        return (
            struct.pack(">I", len(content)) + name + content + struct.pack(">I", zlib.crc32(name + content))
        )

    row = 1 + -(-width * bits * {0: 1, 2: 3, 3: 1, 4: 2, 6: 4}[colour] // 8)
    packer = zlib.compressobj(9)
    count = height if rows is None else rows
    content = b"".join(packer.compress(bytes(row)) for _ in range(count)) + packer.flush()
    head = struct.pack(">IIBBBBB", width, height, bits, colour, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", content) + chunk(b"IEND", b"")


def claiming(suffix: str, side: int) -> bytes:
    """A small image of this format whose header claims so many rows and columns."""
    data = bytearray(encoded(suffix, 8, 8, *((cv2.IMWRITE_WEBP_QUALITY, 90) if suffix == ".webp" else ())))
    if suffix == ".png":
        data[16:24] = struct.pack(">II", side, side)
        data[29:33] = struct.pack(">I", zlib.crc32(data[12:29]))
    elif suffix == ".jpg":
        at = data.index(b"\xff\xc0")
        data[at + 5 : at + 9] = struct.pack(">HH", side, side)
    elif suffix == ".bmp":
        data[18:26] = struct.pack("<ii", side, side)
    elif suffix == ".tiff":
        for tag in (256, 257):
            at = data.index(struct.pack("<HH", tag, 3))
            data[at : at + 12] = struct.pack("<HHII", tag, 4, 1, side)
    elif suffix == ".webp":
        at = data.index(b"VP8 ")
        data[at + 14 : at + 18] = struct.pack("<HH", 16_000, 16_000)
    else:
        data = bytearray(data.replace(b"8 8\n", b"%d %d\n" % (side, side), 1))
    return bytes(data)


@pytest.mark.parametrize("suffix", FORMATS)
@pytest.mark.parametrize(("height", "width"), [(1, 1), (7, 300), (301, 5)])
def test_the_size_of_any_image_is_known_from_its_header(suffix: str, height: int, width: int):
    data = encoded(suffix, height, width)
    header = image_header(data)
    assert header is not None
    assert (header.width, header.height) == (width, height)
    pixels = decoded(data, cv2.IMREAD_UNCHANGED)
    assert pixels is not None
    assert pixels.nbytes <= height * width * header.pixel_bytes


def test_the_size_of_a_lossless_webp_and_of_one_with_transparency_is_known():
    assert image_header(encoded(".webp", 30, 70, cv2.IMWRITE_WEBP_QUALITY, 101)) == ImageHeader(70, 30, 4)
    pixels = np.random.default_rng(0).integers(0, 256, (30, 70, 4), np.uint8)
    header = image_header(cv2.imencode(".webp", pixels)[1].tobytes())
    assert header is not None
    assert (header.width, header.height) == (70, 30)


@pytest.mark.parametrize("suffix", FORMATS)
def test_what_claims_too_much_is_not_decoded_by_any_reader(tmp_path: Path, suffix: str):
    path = tmp_path / f"photo{'.png' if suffix in ('.ppm', '.pgm') else suffix}"
    path.write_bytes(claiming(suffix, SIDE))
    header = image_header(path.read_bytes())
    assert header is not None
    assert not header.fits
    tracemalloc.start()
    with pytest.raises(CameraError, match=rf"\A[^\n]*{path.name}: [^\n]*\Z"):
        read_photograph(path, CAMERA, number=0)
    with pytest.raises(MapError, match=rf"\A[^\n]*{path.name}: [^\n]*\Z"):
        read_map_image(path)
    photos = photo_folder(str(tmp_path))
    with pytest.raises(ConfigError, match=r"picture of \d+ x \d+ pixels; must be"):
        photos.digest()
    with pytest.raises(ConfigError, match="no picture that can be read"):
        photos[0]
    assert tracemalloc.get_traced_memory()[1] < MOST_BYTES
    tracemalloc.stop()


def test_a_small_file_of_a_huge_picture_is_refused_by_the_cameras_size(tmp_path: Path):
    path = tmp_path / "bomb.png"
    path.write_bytes(png_of(9_000, 9_000))
    tracemalloc.start()
    with pytest.raises(CameraError, match="image of 9000 x 9000 px; the camera is calibrated for 640 x 480"):
        read_photograph(path, CAMERA, number=0)
    assert tracemalloc.get_traced_memory()[1] < MOST_BYTES
    tracemalloc.stop()


@pytest.mark.parametrize(("bits", "colour"), [(8, 6), (8, 2), (16, 6), (16, 2), (16, 4), (8, 3)])
def test_a_map_with_more_bytes_than_a_grey_one_is_refused(tmp_path: Path, bits: int, colour: int):
    path = tmp_path / "map.png"
    path.write_bytes(png_of(9_000, 9_000, bits=bits, colour=colour, rows=9))
    with pytest.raises(
        MapError, match=r"image of 9000 x 9000 pixels of [48] bytes; at most 200,000,000 bytes"
    ):
        read_map_image(path)


def test_a_plain_pgm_takes_no_more_than_its_file(tmp_path: Path):
    path = tmp_path / "map.pgm"
    path.write_bytes(b"P2\n2 2\n255\n" + b"255 " * 1_500_000)
    size = path.stat().st_size
    tracemalloc.start()
    with pytest.warns(UserWarning, match="1,499,996 numbers after the last of 2 x 2 pixels"):
        assert read_map_image(path).grey.tolist() == [[255, 255], [255, 255]]
    used = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert used < size + 40_000_000


@pytest.mark.parametrize("gap", [b" ", b"\n", b"\r", b"\t# a comment\n", b"\r\n"])
def test_a_plain_pgm_is_read_in_pieces_as_in_one(tmp_path: Path, gap: bytes):
    greys = np.random.default_rng(0).integers(0, 256, (600, 700), np.uint8)
    path = tmp_path / "map.pgm"
    path.write_bytes(b"P2\n700 600\n255\n" + gap.join(b"%d" % grey for grey in greys.ravel()))
    assert np.array_equal(read_map_image(path).grey, greys)


def test_a_comment_longer_than_a_piece_is_no_pixel(tmp_path: Path):
    path = tmp_path / "map.pgm"
    path.write_bytes(b"P2\n2 1\n255\n#" + b"7 " * 1_000_000 + b"\n1 2")
    assert read_map_image(path).grey.tolist() == [[1, 2]]
    path.write_bytes(b"P2\n2 1\n255\n1 2 #" + b"7 " * 1_000_000)
    assert read_map_image(path).grey.tolist() == [[1, 2]]


@pytest.mark.parametrize("suffix", [".png", ".jpg", ".bmp"])
def test_what_follows_a_maps_image_is_told(tmp_path: Path, suffix: str):
    path = tmp_path / f"map{suffix}"
    greys = np.full((30, 40), 205, np.uint8)
    path.write_bytes(cv2.imencode(suffix, greys)[1].tobytes() + b"x" * 4096)
    with pytest.warns(UserWarning, match="4,096 bytes after the end of the image are left out"):
        assert abs(read_map_image(path).grey.astype(int) - 205).max() < 3


@pytest.mark.parametrize("suffix", FORMATS)
def test_photos_keep_their_colours(tmp_path: Path, suffix: str):
    """They were decoded to blue, green, red and turned around; datasets made so stay as they are."""
    data = encoded(suffix, 40, 50)
    (tmp_path / f"photo{'.png' if suffix in ('.ppm', '.pgm') else suffix}").write_bytes(data)
    bgr = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)
    assert np.array_equal(photo_folder(str(tmp_path))[0], cv2.cvtColor(bgr, cv2.COLOR_BGR2RGB))


def test_a_pipe_among_photos_is_told(tmp_path: Path):
    os.mkfifo(tmp_path / "photo.jpg")
    with pytest.raises(ConfigError, match=r"photo\.jpg: cannot be read \(is no regular file\)"):
        photo_folder(str(tmp_path)).digest()


@given(st.sampled_from(FORMATS), st.integers(0, 200), st.binary(min_size=1, max_size=12))
def test_no_damage_of_a_header_ends_in_anything_but_none_or_an_image(suffix: str, at: int, damage: bytes):
    data = bytearray(encoded(suffix, 8, 8))
    data[at : at + len(damage)] = damage
    header = image_header(bytes(data))
    assert header is None or header.fits in (True, False)
    assert image_end(bytes(data)) is None or image_end(bytes(data)) <= max(len(data), 8)
    pixels = decoded(bytes(data), cv2.IMREAD_COLOR)
    assert pixels is None or pixels.shape[0] * pixels.shape[1] <= MAX_PIXELS
