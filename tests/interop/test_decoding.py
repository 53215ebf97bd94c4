import cv2
import numpy as np
import pytest

from rendezvous.interop.decoding import decoded, is_whole

PNG = cv2.imencode(".png", np.random.default_rng(0).integers(0, 256, (9, 13), np.uint8))[1].tobytes()


def test_a_whole_image_is_whole_whatever_follows_it():
    assert is_whole(PNG)
    assert is_whole(PNG + b"more")


def test_no_cut_and_no_damage_goes_unnoticed():
    for place in range(8, len(PNG)):
        assert not is_whole(PNG[:place])
        damaged = bytearray(PNG)
        damaged[place] ^= 0x40
        assert not is_whole(bytes(damaged))


def jpeg(*, progressive: bool = False, restarts: int = 0) -> bytes:
    pixels = np.random.default_rng(0).integers(0, 256, (40, 56, 3), np.uint8)
    options = [cv2.IMWRITE_JPEG_PROGRESSIVE, int(progressive), cv2.IMWRITE_JPEG_RST_INTERVAL, restarts]
    return cv2.imencode(".jpg", pixels, options)[1].tobytes()


def with_thumbnail(data: bytes) -> bytes:
    """Another JPEG within the first segment, as cameras write it."""
    inner = b"Exif\0\0" + jpeg()
    return data[:2] + b"\xff\xe1" + (len(inner) + 2).to_bytes(2, "big") + inner + data[2:]


JPEGS = {
    "baseline": jpeg(),
    "progressive": jpeg(progressive=True),
    "restarts": jpeg(restarts=2),
    "thumbnail": with_thumbnail(jpeg()),
}


@pytest.mark.parametrize("kind", JPEGS)
def test_a_jpeg_is_whole_whatever_follows_its_end(kind: str):
    data = JPEGS[kind]
    for more in (b"", b"\0" * 5000, b"\xff" * 9, b"ftypmp42" + jpeg()):
        assert is_whole(data + more)
        assert decoded(data + more, cv2.IMREAD_COLOR).shape == (40, 56, 3)


@pytest.mark.parametrize("kind", JPEGS)
def test_a_jpeg_that_is_cut_short_is_not_whole_though_zeros_fill_it_up(kind: str):
    data = JPEGS[kind]
    for length in range(2, len(data), 37):
        assert not is_whole(data[:length])
        assert not is_whole(data[:length] + b"\0" * 3000)
    assert not is_whole(data[:-1])


@pytest.mark.parametrize("suffix", [".png", ".bmp", ".webp", ".tiff"])
def test_what_cannot_be_decoded_is_none_and_silent(suffix: str, capfd):
    level = cv2.utils.logging.getLogLevel()
    whole = cv2.imencode(suffix, np.zeros((90, 120, 3), np.uint8))[1].tobytes()
    assert decoded(whole, cv2.IMREAD_COLOR).shape == (90, 120, 3)
    assert decoded(whole[: len(whole) // 2], cv2.IMREAD_COLOR) is None
    assert capfd.readouterr().err == ""
    assert cv2.utils.logging.getLogLevel() == level


def test_a_damaged_png_is_none_and_silent(capfd):
    damaged = bytearray(PNG)
    damaged[len(PNG) // 2] ^= 0x40
    assert decoded(bytes(damaged), cv2.IMREAD_COLOR) is None
    assert capfd.readouterr().err == ""


def test_no_bytes_and_too_many_pixels_are_none():
    assert decoded(b"", cv2.IMREAD_COLOR) is None
    assert decoded(b"P5\n99999 99999\n255\n", cv2.IMREAD_COLOR) is None
