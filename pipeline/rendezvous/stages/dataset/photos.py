"""A folder of the user's photos, used as backgrounds of rendered scenes."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import overload

import cv2
import numpy as np

from rendezvous.errors import ConfigError
from rendezvous.geometry.camera import Image

SUFFIXES = (".jpg", ".jpeg", ".png", ".bmp", ".tif", ".tiff", ".webp")


@dataclass(frozen=True, slots=True)
class PhotoFolder(Sequence[Image]):
    """The photos of a folder, each read when it is asked for, so that thousands fit in memory."""

    paths: tuple[Path, ...]

    def __len__(self) -> int:
        return len(self.paths)

    @overload
    def __getitem__(self, index: int) -> Image: ...
    @overload
    def __getitem__(self, index: slice) -> PhotoFolder: ...
    def __getitem__(self, index: int | slice) -> Image | PhotoFolder:
        """One photo (H, W, 3) uint8, sRGB.

        Raises:
            ConfigError: the file is not an image.
        """
        if isinstance(index, slice):
            return PhotoFolder(self.paths[index])
        path = self.paths[index]
        content = np.frombuffer(_content(path), np.uint8)
        try:
            bgr = cv2.imdecode(content, cv2.IMREAD_COLOR) if len(content) else None
        except cv2.error:  # more pixels than OpenCV decodes
            bgr = None
        if bgr is None:
            raise ConfigError(f"{path}: no picture that can be read; render.backgrounds takes photos")
        return np.asarray(cv2.cvtColor(bgr, cv2.COLOR_BGR2RGB))

    def digest(self) -> str:
        """SHA-256 of all names and contents.

        Raises:
            ConfigError: a file cannot be read, or is not an image that OpenCV decodes.
        """
        h = hashlib.sha256()
        for path in self.paths:
            content = _content(path)
            if not _is_picture(content):
                raise ConfigError(f"{path}: no picture that can be read; render.backgrounds takes photos")
            h.update(os.fsencode(path.name) + f" {len(content)} ".encode() + content)
        return h.hexdigest()


def photo_folder(folder: str | None) -> PhotoFolder:
    """The photos in and below a folder; none if no folder is given.

    Raises:
        ConfigError: there is no such folder, or no photo in it.
    """
    if folder is None:
        return PhotoFolder(())
    root = Path(folder)
    if not root.is_dir():
        raise ConfigError(f"render.backgrounds is {folder!r}; must be a folder of photos, or null")
    paths = sorted(p for p in root.rglob("*") if p.suffix.lower() in SUFFIXES and not p.is_dir())
    if not paths:
        raise ConfigError(f"render.backgrounds: no photo in {folder} ({', '.join(SUFFIXES)})")
    return PhotoFolder(tuple(paths))


def _is_picture(content: bytes) -> bool:
    """Whether OpenCV knows the kind of file, by its first bytes."""
    # A file in memory: OpenCV takes a name here, and crashes on one that is not UTF-8.
    descriptor = os.memfd_create("photo")
    try:
        os.write(descriptor, content[:1024])
        return bool(cv2.haveImageReader(f"/proc/self/fd/{descriptor}"))
    finally:
        os.close(descriptor)


def _content(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError as error:
        reason = (error.strerror or str(error)).lower()
        raise ConfigError(f"{path}: cannot be read ({reason}); render.backgrounds takes photos") from error
