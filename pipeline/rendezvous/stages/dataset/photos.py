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
from rendezvous.interop.decoding import decoded
from rendezvous.interop.given_file import given_bytes
from rendezvous.interop.image_header import MAX_PIXELS, image_header
from rendezvous.resources import exists

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
        rgb = decoded(_content(path), cv2.IMREAD_COLOR_RGB)
        if rgb is None:
            raise ConfigError(f"{path}: no picture that can be read; render.backgrounds takes photos")
        return np.asarray(rgb, np.uint8)

    def digest(self) -> str:
        """SHA-256 of all names and contents.

        Raises:
            ConfigError: a file cannot be read, or is not an image that is read here.
        """
        h = hashlib.sha256()
        for path in self.paths:
            content = _content(path)
            header = image_header(content)
            if header is None:
                raise ConfigError(f"{path}: no picture that can be read; render.backgrounds takes photos")
            if not header.fits:
                raise ConfigError(
                    f"{path}: picture of {header.width} x {header.height} pixels; must be at least 1 and at "
                    f"most {MAX_PIXELS:,}"
                )
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
    if not (exists(root) and root.is_dir()):
        raise ConfigError(f"render.backgrounds is {folder!r:.200}; must be a folder of photos, or null")
    paths = sorted(p for p in root.rglob("*") if p.suffix.lower() in SUFFIXES and not p.is_dir())
    if not paths:
        raise ConfigError(f"render.backgrounds: no photo in {folder} ({', '.join(SUFFIXES)})")
    return PhotoFolder(tuple(paths))


def _content(path: Path) -> bytes:
    try:
        return given_bytes(path)
    except OSError as error:
        reason = (error.strerror or str(error)).lower()
        raise ConfigError(f"{path}: cannot be read ({reason}); render.backgrounds takes photos") from error
