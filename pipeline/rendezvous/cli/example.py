"""The command that copies shipped files, to try or to change."""

from __future__ import annotations

import shlex
from collections.abc import Iterable
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from rendezvous.errors import StoreError
from rendezvous.resources import ROBOTS, ROOT, SIGHTING

_COMMAND = "command.txt"


class Example(StrEnum):
    """What can be copied."""

    SIGHTING = "sighting"
    STAGES = "stages"
    ROBOT = "robot"


def example(
    what: Annotated[
        Example,
        typer.Argument(
            help="sighting: two maps and an image to fuse; stages: stages.yaml; robot: the files of one."
        ),
    ],
    out: Annotated[
        Path | None,
        typer.Option("--out", help="Folder to write to; by default one named like the example, or here."),
    ] = None,
) -> None:
    """Copy shipped files: a sighting to try `fuse` on, stages.yaml or a robot to make your own of."""
    match what:
        case Example.SIGHTING:
            folder = out or Path("sighting")
            _copied([path for path in SIGHTING.iterdir() if path.name != _COMMAND], folder)
            command = (SIGHTING / _COMMAND).read_text(encoding="utf-8")
            print(command.replace("FOLDER", shlex.quote(str(folder))), end="")
        case Example.STAGES:
            print(*_copied([ROOT / "stages.yaml"], out or Path()), sep="\n")
        case Example.ROBOT:
            print(*_copied((ROBOTS / "burger").glob("robot.*"), out or Path("robot")), sep="\n")


def _copied(files: Iterable[Path], folder: Path) -> list[Path]:
    """Copy files to a folder; returns the copies. A file that is there already may have been changed.

    Raises:
        StoreError: another file of that name is there, or it cannot be written.
    """
    copies = {folder / file.name: file.read_bytes() for file in sorted(files)}
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for copy, content in copies.items():
            if copy.exists() and copy.read_bytes() != content:
                raise StoreError(f"{copy}: exists and is not the shipped file; --out names another folder")
        for copy, content in copies.items():
            copy.write_bytes(content)
    except OSError as error:
        raise StoreError(f"{folder}: cannot be written ({(error.strerror or str(error)).lower()})") from error
    return list(copies)
