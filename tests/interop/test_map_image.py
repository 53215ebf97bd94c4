from __future__ import annotations

import struct
import tracemalloc
import warnings
import zlib

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rendezvous.errors import MapError
from rendezvous.interop.map_image import read_map_image

GREYS = np.random.default_rng(0).integers(0, 256, (9, 13), np.uint8)


def _read(tmp_path, data: bytes):
    path = tmp_path / "map.image"
    path.write_bytes(data)
    return read_map_image(path)


def _encoded(suffix: str, pixels: np.ndarray = GREYS) -> bytes:
    return cv2.imencode(suffix, pixels)[1].tobytes()


def _png(
    width: int, height: int, *, colour: int, rows: bytes, end: bool = True, bits: int = 8, chunks=()
) -> bytes:
    """A PNG of one of PNG's colour types, each row after its filter byte 0."""
    chunks = [
        (b"IHDR", struct.pack(">IIBBBBB", width, height, bits, colour, 0, 0, 0)),
        *chunks,
        (b"IDAT", zlib.compress(rows)),
        (b"IEND", b""),
    ]
    parts = [
        struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data))
        for name, data in chunks[: None if end else -1]
    ]
    return b"\x89PNG\r\n\x1a\n" + b"".join(parts)


@given(
    st.integers(1, 65535),
    st.integers(1, 7),
    st.integers(1, 7),
    st.integers(0, 999),
    st.sampled_from([b"\n", b" ", b"\n# CREATOR: map_saver 0.050 m/pix\n", b"\t \r\n"]),
    st.booleans(),
)
def test_any_pgm_gives_the_numbers_in_it(tmp_path_factory, white, width, height, seed, gap, plain):
    values = np.random.default_rng(seed).integers(0, white + 1, (height, width))
    fields = [b"P2" if plain else b"P5", b"%d" % width, b"%d" % height, b"%d" % white]
    wide = values.astype(">u2" if white > 255 else np.uint8).tobytes()
    body = b"\n".join(b" ".join(b"%d" % v for v in row) for row in values) if plain else wide
    image = _read(tmp_path_factory.mktemp("pgm"), gap.join(fields) + b"\n" + body)
    assert np.array_equal(image.grey, values)
    assert (image.white, image.alpha) == (white, None)


RASTER = bytes([0, 205, 254, 10, 205, 0])


def _silently(tmp_path, data: bytes) -> list[list[int]]:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        return _read(tmp_path, data).grey.tolist()


HEADERS = (
    b"P5\n3 2\n255\n",
    b"P5\r\n3 2\r\n255\r\n",
    b"P5\r\n# CREATOR: map_saver 0.050 m/pix\r\n3 2\r\n255\r\n",
    b"P5\r3 2\r255\r",
    b"P5#x\n3#width\n#\n2\n#maximum\n255\n",
    b"P5\n3 2\n255#x\n",
)
SLOPPY_HEADERS = (
    b"P5 3 2 255\r\n",
    b"P5\n3 2\n255 # x\n",
    b"P5\n3 2\n255  \n",
    b"P5\n3 2\n255 # x\r\n",
    b"P5\n3 2\n255\n#x\n#\n",
)


@pytest.mark.parametrize("header", HEADERS + SLOPPY_HEADERS)
def test_the_header_of_a_binary_pgm_ends_where_the_size_says(tmp_path, header):
    assert _silently(tmp_path, header + RASTER) == [[0, 205, 254], [10, 205, 0]]
    assert _silently(tmp_path, header + RASTER + b"\n") == [[0, 205, 254], [10, 205, 0]]


@pytest.mark.parametrize("header", HEADERS)
def test_no_pixel_goes_missing_after_any_header(tmp_path, header):
    with pytest.raises(MapError, match="PGM is cut off: 5 of 3 x 2 = 6 pixels"):
        _read(tmp_path, header + RASTER[:-1])


def test_pixels_that_look_like_white_space_are_pixels(tmp_path):
    assert _silently(tmp_path, b"P5\n3 1\n255\n\n\r ") == [[10, 13, 32]]
    assert _silently(tmp_path, b"P5 3 1 255\r\n\n\n") == [[10, 10, 10]]


@pytest.mark.parametrize(("white", "pixel"), [(255, b"\1"), (256, b"\0\1"), (65535, b"\0\1")])
def test_a_pixel_has_two_bytes_from_a_maximum_of_256(tmp_path, white, pixel):
    assert _silently(tmp_path, b"P5 2 1 %d\n" % white + pixel * 2) == [[1, 1]]


def test_the_largest_image_is_not_too_large(tmp_path):
    with pytest.raises(MapError, match="PGM is cut off: 0 of 10000 x 10000"):
        _read(tmp_path, b"P5\n10000 10000\n255\n")
    with pytest.raises(MapError, match="image of 10000 x 10001 pixels; must be"):
        _read(tmp_path, b"P5\n10000 10001\n255\n")


def test_a_text_conversion_of_all_the_file_is_undone(tmp_path):
    converted = (b"P5\n3 2\n255\n" + RASTER).replace(b"\n", b"\r\n")
    assert _silently(tmp_path, converted) == [[0, 205, 254], [10, 205, 0]]


def test_a_plain_pgm_may_have_crlf_and_comments(tmp_path):
    text = b"P2\r\n# x\r\n3 2\r\n255 # y\r\n0 205 254 # z\r\n10 205 0\r\n"
    assert _silently(tmp_path, text) == [[0, 205, 254], [10, 205, 0]]


@pytest.mark.parametrize(
    ("data", "said"),
    [
        (b"P5\n3 2\n255\n" + RASTER + b"more", "4 bytes after the last of 3 x 2 pixels are left out"),
        (b"P5\r\n3 2\r\n255\r\n" + RASTER + b"more", "4 bytes after the last of 3 x 2 pixels"),
        (b"P2\n3 2\n255\n0 205 254 10 205 0 7 7", "2 numbers after the last of 3 x 2 pixels"),
    ],
)
def test_what_follows_the_last_pixel_is_told(tmp_path, data, said):
    with pytest.warns(UserWarning, match=said):
        assert _read(tmp_path, data).grey.tolist() == [[0, 205, 254], [10, 205, 0]]


@pytest.mark.parametrize(
    ("bits", "colour", "rows", "chunks", "expected"),
    [
        (1, 0, [0, 0b10110000], [], [255, 0, 255, 255]),
        (4, 0, [0, 0x0D, 0xF0], [], [0, 221, 255, 0]),
        (8, 3, [0, 0, 1, 2, 1], [(b"PLTE", bytes([0] * 3 + [205] * 3 + [254] * 3))], [0, 205, 254, 205]),
        (8, 0, [0, 0, 205, 254, 1], [(b"gAMA", struct.pack(">I", 45455))], [0, 205, 254, 1]),
    ],
)
def test_a_png_of_any_depth_gives_its_greys(tmp_path, bits, colour, rows, chunks, expected):
    image = _read(tmp_path, _png(4, 1, bits=bits, colour=colour, rows=bytes(rows), chunks=chunks))
    assert (image.grey.tolist(), image.alpha, image.white) == ([expected], None, 255)


def test_a_pgm_is_read_as_opencv_reads_it(tmp_path):
    assert np.array_equal(_read(tmp_path, _encoded(".pgm")).grey, GREYS)


def test_grey_with_transparency_is_read(tmp_path):
    image = _read(tmp_path, _png(2, 1, colour=4, rows=bytes([0, 10, 0, 200, 255])))
    assert image.grey.tolist() == [[10, 200]]
    assert image.alpha.tolist() == [[0, 255]]


def test_sixteen_bits_are_kept(tmp_path):
    deep = GREYS.astype(np.uint16) * 257
    image = _read(tmp_path, _encoded(".png", deep))
    assert np.array_equal(image.grey, deep)
    assert image.white == 65535


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"", r"0 bytes that are no PGM \(P2, P5\), PNG, BMP or JPEG image"),
        (b"\xff\xd8\xff\xe0 a photo", "image of 0 x 0 pixels"),
        (_encoded(".jpg")[:-1], "bytes of a damaged or cut off image"),
        (b"\xff\xd8\xff\xc0\0\x0b\x08\xff\xfe\xff\xff\1", "image of 65535 x 65534 pixels"),
        (b"P6\n1 1\n255\n\0\0\0", "bytes that are no PGM"),
        (b"P5", "is no PGM: its header lacks"),
        (b"P5\n3 -2\n255\n", "is no PGM: its header lacks"),
        (b"P5\n3 2\n255\n\0\0\0\0\0", r"PGM is cut off: 5 of 3 x 2 = 6 pixels"),
        (b"P5\n3 1\n65535\n\0\0\0\0\0", r"PGM is cut off: 2 of 3 x 1 = 3 pixels"),
        (b"P2\n3 1\n255\n1 2", r"PGM is cut off: 2 of 3 x 1 = 3 pixels"),
        (b"P2\n3 1\n255\n", r"PGM is cut off: 0 of 3 x 1 = 3 pixels"),
        (b"P2\n3 1\n255\n1 2 x", "plain PGM .* with something else than numbers"),
        (b"P2\n1 1\n255\n123456", "plain PGM .* with something else than numbers"),
        (b"P2\n3 1\n255\n1 2 256", "PGM holds grey 256; its maximum is 255"),
        (b"P5\n1 1\n0\n\0", "PGM with maximum 0; must be from 1 to 65535"),
        (b"P5\n1 1\n65536\n\0", "PGM with maximum 65536"),
        (b"P5\n0 5\n255\n", "image of 0 x 5 pixels; must be at least 1"),
        (b"P5\n100000 100000\n255\n", "image of 100000 x 100000 pixels; .* at most 100,000,000"),
        (_png(100000, 100000, colour=0, rows=b""), "image of 100000 x 100000 pixels"),
        (_png(4, 4, colour=0, rows=bytes(20), end=False), "bytes of a damaged or cut off image"),
        (_encoded(".png")[:-1], "bytes of a damaged or cut off image"),
        (_encoded(".bmp")[:-1], "bytes of a damaged or cut off image"),
        (_encoded(".bmp")[:20], "20 bytes that are no PGM"),
        (_encoded(".png", np.dstack([GREYS, GREYS, 255 - GREYS])), "is a coloured image; a map is grey"),
    ],
)
def test_a_damaged_image_is_named_with_its_fault(tmp_path, data, message):
    with pytest.raises(MapError, match=rf"\A[^\n]*map\.image: [^\n]*{message}[^\n]*\Z"):
        _read(tmp_path, data)


def test_a_decoder_says_nothing_of_its_own(tmp_path, capfd):
    damaged = bytearray(_encoded(".png"))
    damaged[-20] ^= 1
    with pytest.raises(MapError, match="damaged or cut off"):
        _read(tmp_path, bytes(damaged))
    assert capfd.readouterr().err == ""


@pytest.mark.parametrize("suffix", [".png", ".bmp", ".pgm"])
def test_no_cut_goes_unnoticed(tmp_path, suffix):
    data = _encoded(suffix)
    for length in range(0, len(data), 7):
        with pytest.raises(MapError):
            _read(tmp_path, data[:length])


@pytest.mark.parametrize(
    "data", [b"P5\n99999 99999\n255\n", b"P2\n99999 99999\n255\n", _png(99999, 99999, colour=0, rows=b"")]
)
def test_a_huge_image_costs_no_memory(tmp_path, data):
    tracemalloc.start()
    with pytest.raises(MapError, match="99999 x 99999"):
        _read(tmp_path, data)
    assert tracemalloc.get_traced_memory()[1] < 1_000_000
    tracemalloc.stop()


@pytest.mark.parametrize("channels", [1, 3])
def test_a_jpeg_is_read_to_its_noise(tmp_path, channels):
    greys = np.full((40, 56), 205, np.uint8)
    greys[8:24] = 0
    image = _read(tmp_path, _encoded(".jpg", np.dstack([greys] * channels).squeeze()))
    assert np.abs(image.grey.astype(int) - greys).max() < 10


def test_a_bmp_whose_top_row_comes_first_is_the_same_image(tmp_path):
    """Its height is negative; most have the bottom row first."""
    usual = _encoded(".bmp")
    start, stride, height = struct.unpack("<I", usual[10:14])[0], 16, len(GREYS)  # 13 pixels and 3 bytes
    assert len(usual) == start + stride * height
    rows = [usual[start + stride * row :][:stride] for row in reversed(range(height))]
    turned = usual[:22] + struct.pack("<i", -height) + usual[26:start] + b"".join(rows)
    assert (_read(tmp_path, turned).grey == GREYS).all()
    assert (_read(tmp_path, usual).grey == GREYS).all()
