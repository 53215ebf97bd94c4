"""The folder of one evaluation's recorded figures: read for a report, written for later ones."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Generic

from rich.console import Console

from rendezvous.errors import ConfigError
from rendezvous.evaluation.report.recorded_figures import Row, read_recorded
from rendezvous.store.disk import Disk
from rendezvous.store.read import read_json
from rendezvous.store.records import json_bytes


@dataclass(frozen=True, slots=True, kw_only=True)
class RecordFolder(Generic[Row]):
    """Recorded rows of one evaluation."""

    disk: Disk
    rows: Mapping[str, Row]  # by file name

    @staticmethod
    def read(folder: Path, kind: type[Row], *, command: str) -> RecordFolder[Row]:
        """All rows of a folder; none if it does not exist. Folders below it belong to other evaluations.

        Args:
            folder: of one evaluation.
            kind: of the rows, such as `RecordedFigures[PoseSummary]`.
            command: that writes them.

        Raises:
            StoreError: a file is not such a row.
        """
        disk = Disk(str(folder))
        names = [name for name in disk.names() if name.endswith(".json") and "/" not in name]
        rows = {
            name: read_recorded(read_json(disk, name) or {}, kind, where=disk.shown(name), command=command)
            for name in names
        }
        return RecordFolder(disk=disk, rows=rows)

    def of_split(self, split: str) -> dict[str, Row]:
        """Rows on a split, by name."""
        return {row.name: row for row in self.rows.values() if row.conditions.split == split}

    def require_no_loss(self, names: Iterable[str], conditions: Any) -> None:
        """Check that no row would be replaced by one that was measured on less.

        Args:
            names: of the rows that would be written.
            conditions: of them.

        Raises:
            ConfigError: names the file and how to go on.
        """
        for name in map(conditions.file_name, names):
            if name not in self.rows:
                continue
            kept, noun = self.rows[name].conditions.measured_on
            count, _ = conditions.measured_on
            if kept > count:
                raise ConfigError(
                    f"{self.disk.shown(name)}: recorded from {kept} {noun}, which --record would replace by "
                    f"{count}; measure as many, name another folder with --records, or delete the file"
                )

    def keep(self, rows: Iterable[Row], console: Console) -> None:
        """Write rows, over those of the same names."""
        for row in rows:
            name = row.conditions.file_name(row.name)
            self.disk.write(name, json_bytes(row.to_json()))
            console.print(f"recorded {self.disk.shown(name)}", highlight=False)
