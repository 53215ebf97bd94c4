"""Folders of numbered images for other programs, filled from the published dataset."""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from itertools import chain, islice
from pathlib import Path

from rich.console import Console

from rendezvous.commands.export.dataset_images import LabelledImage, PublishedSplit
from rendezvous.engine.progress import meter
from rendezvous.errors import StoreError

BATCH_IMAGES = 64

LARGEST_COUNT = 10**6  # names have six digits

_NUMBERED = re.compile(r"(\d{6})\.(png|json)")


def numbered(number: int) -> str:
    """Name of an image's files without the suffix."""
    return f"{number:06d}"


def check_room(folder: Path, images: int) -> None:
    """Check that this many images can be numbered in a folder and replace all those already there.

    Raises:
        StoreError: there are too many, or files of a larger export would be left in the folder.
    """
    if images > LARGEST_COUNT:
        raise StoreError(
            f"{folder}: {images} images; at most {LARGEST_COUNT} go into one folder, so set --count"
        )
    try:
        names = sorted(path.name for path in folder.iterdir()) if folder.exists() else []
    except OSError as error:
        raise StoreError(_unwritable(folder, error)) from error
    for name in names:
        match = _NUMBERED.fullmatch(name)
        if match and int(match[1]) >= images:
            raise StoreError(
                f"{folder / name}: left by an export of more than the {images} images of this one; "
                "empty the folder, or name another with --out"
            )


def written_images(
    splits: Sequence[PublishedSplit],
    count: int,
    write: Callable[[int, LabelledImage], None],
    *,
    console: Console,
    keep: Callable[[LabelledImage], bool] = lambda image: True,
) -> Iterator[tuple[int, LabelledImage]]:
    """Call `write` for every image and yield number and image, in order, once they are written.

    Args:
        splits: the images.
        count: maximum number of images of each split.
        write: writes one image's files; called in several threads, as encoding releases the GIL.
        console: shows progress.
        keep: selects the images to write; they are numbered without gaps.
    """
    total = sum(min(count, split.rows) for split in splits)
    images = chain.from_iterable(islice(split.images(), count) for split in splits)
    start = 0
    with (
        meter(
            "export", total=-(-total // BATCH_IMAGES), console=console, parts="batches", rows="images"
        ) as report,
        ThreadPoolExecutor(len(os.sched_getaffinity(0))) as threads,
    ):
        while batch := list(islice(images, BATCH_IMAGES)):
            kept = [image for image in batch if keep(image)]
            numbers = range(start, start + len(kept))
            list(threads.map(write, numbers, kept))
            yield from zip(numbers, kept, strict=True)
            start += len(kept)
            report.advance(len(kept), made=True)


def write_file(path: Path, content: bytes) -> None:
    """Write a file completely or not at all.

    Raises:
        StoreError: it cannot be written.
    """
    temporary = path.with_name(f"{path.name}.tmp-{os.getpid()}")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        try:
            temporary.write_bytes(content)
            temporary.replace(path)
        finally:
            temporary.unlink(missing_ok=True)
    except OSError as error:
        raise StoreError(_unwritable(path, error)) from error


def remove_file(path: Path) -> None:
    """Remove a file if it is there.

    Raises:
        StoreError: it cannot be removed.
    """
    try:
        path.unlink(missing_ok=True)
    except OSError as error:
        raise StoreError(_unwritable(path, error)) from error


def _unwritable(path: Path, error: OSError) -> str:
    return f"{path}: cannot be written ({(error.strerror or str(error)).lower()}); --out names a folder"
