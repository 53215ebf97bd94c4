"""Photos are decoded from memory, so that their names may be anything a file system allows."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

import rendezvous
from rendezvous.errors import ConfigError
from rendezvous.stages.dataset.photos import SUFFIXES, photo_folder


@pytest.mark.parametrize("suffix", SUFFIXES)
@pytest.mark.parametrize("name", ["photo", "caf\udce9", "\u732b \U0001f916"])
def test_a_photo_of_any_name_and_kind_is_read(tmp_path: Path, name: str, suffix: str) -> None:
    pixels = np.full((40, 60, 3), (90, 120, 200), np.uint8)
    (tmp_path / f"{name}{suffix}").write_bytes(cv2.imencode(suffix, pixels[..., ::-1])[1].tobytes())
    photos = photo_folder(str(tmp_path))
    assert len(photos.digest()) == 64
    assert np.abs(photos[0].astype(int) - pixels).max() <= 4


def test_the_digest_follows_names_and_contents(tmp_path: Path) -> None:
    digests = []
    for name, value in (("a.png", 1), ("a.png", 2), ("b\udcff.png", 2), ("c.png", 2)):
        folder = tmp_path / str(len(digests))
        folder.mkdir()
        (folder / name).write_bytes(cv2.imencode(".png", np.full((4, 4, 3), value, np.uint8))[1].tobytes())
        digests.append(photo_folder(str(folder)).digest())
    assert len(set(digests)) == 4


def test_no_module_lets_opencv_open_a_file_by_name() -> None:
    """OpenCV crashes on names that are not UTF-8."""
    code = {path: path.read_text() for path in Path(rendezvous.__file__).parent.rglob("*.py")}
    assert len(code) > 100
    for call in ("imread", "imwrite", "imcount", "VideoCapture", "FileStorage"):
        assert not [path for path, text in code.items() if f"cv2.{call}" in text]


def test_folders_without_photos_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="must be a folder of photos"):
        photo_folder(str(tmp_path / "none"))
    with pytest.raises(ConfigError, match="no photo in"):
        photo_folder(str(tmp_path))
    (tmp_path / "folder.jpg").mkdir()
    with pytest.raises(ConfigError, match="no photo in"):
        photo_folder(str(tmp_path))


@pytest.mark.parametrize("content", [b"no picture", b""])
def test_what_is_no_photo_is_named_before_anything_is_drawn(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "broken.jpg").write_bytes(content)
    photos = photo_folder(str(tmp_path))
    for read in (photos.digest, lambda: photos[0]):
        with pytest.raises(ConfigError, match=r"broken\.jpg: no picture that can be read"):
            read()
    (tmp_path / "broken.jpg").unlink()
    (tmp_path / "broken.jpg").symlink_to(tmp_path / "gone.jpg")
    with pytest.raises(ConfigError, match=r"broken\.jpg: cannot be read \(no such file"):
        photo_folder(str(tmp_path)).digest()
