"""The folder of one evaluation's figures from earlier runs, read for a report and kept for later ones."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Generic

from rich.console import Console

from rendezvous.errors import ConfigError
from rendezvous.evaluation.report.recorded_figures import (
    Figures,
    ImageConditions,
    RecordedFigures,
    recorded_from_json,
)
from rendezvous.store.disk import Disk
from rendezvous.store.read import read_json
from rendezvous.store.records import json_bytes


@dataclass(frozen=True, slots=True, kw_only=True)
class FiguresFolder(Generic[Figures]):
    """Recorded figures of one evaluation.

    Attributes:
        disk: the folder.
        rows: by file name.
    """

    disk: Disk
    rows: Mapping[str, RecordedFigures[Figures]]

    @staticmethod
    def read(folder: Path, kind: type[Figures], *, command: str) -> FiguresFolder[Figures]:
        """All of the folder; none if there is no folder.

        Args:
            folder: of one evaluation alone.
            kind: of its figures.
            command: that writes them.

        Raises:
            StoreError: a file holds no such figures.
        """
        disk = Disk(str(folder))
        rows = {
            name: recorded_from_json(
                read_json(disk, name) or {}, kind, where=disk.shown(name), command=command
            )
            for name in disk.names()
            if name.endswith(".json")
        }
        return FiguresFolder(disk=disk, rows=rows)

    def of_split(self, split: str) -> dict[str, RecordedFigures[Figures]]:
        """Those of a split, by the variant's name."""
        return {row.name: row for row in self.rows.values() if row.conditions.split == split}

    def require_no_loss(self, names: Iterable[str], conditions: ImageConditions) -> None:
        """See that none would be replaced by figures of fewer images.

        Raises:
            ConfigError: names the file and how to go on.
        """
        for name, row in self.of_split(conditions.split).items():
            if name in names and row.conditions.images > conditions.images:
                raise ConfigError(
                    f"{self.disk.shown(row.file_name)}: recorded from {row.conditions.images} images, which "
                    f"--record would replace by {conditions.images}; measure as many, name another folder "
                    "with --records, or delete the file"
                )

    def keep(self, rows: Iterable[RecordedFigures[Figures]], console: Console) -> None:
        """Write figures, over those of the same names."""
        for row in rows:
            self.disk.write(row.file_name, json_bytes(row.to_json()))
            console.print(f"recorded {self.disk.shown(row.file_name)}", highlight=False)
