"""Recorded rows: figures of earlier runs, read for a report and kept for later ones."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

from rich.console import Console

from rendezvous.errors import ConfigError
from rendezvous.evaluation.frame_error.measured_row import Conditions, MeasuredRow
from rendezvous.store.disk import Disk
from rendezvous.store.read import read_json
from rendezvous.store.records import json_bytes


@dataclass(frozen=True, slots=True, kw_only=True)
class RecordedRows:
    """A folder of recorded rows.

    Attributes:
        disk: the folder.
        rows: by file name.
    """

    disk: Disk
    rows: Mapping[str, MeasuredRow]

    @staticmethod
    def read(folder: Path) -> RecordedRows:
        """All of the folder; none if there is no folder.

        Raises:
            StoreError: a file holds no recorded row.
        """
        disk = Disk(str(folder))
        rows = {
            name: MeasuredRow.from_json(read_json(disk, name) or {}, where=disk.shown(name))
            for name in disk.names()
            # Folders below hold the figures of other evaluations.
            if name.endswith(".json") and "/" not in name
        }
        return RecordedRows(disk=disk, rows=rows)

    def beside(self, conditions: Conditions) -> dict[str, MeasuredRow]:
        """By method, the rows that may stand in one table with what is measured under these conditions."""
        return {row.method: row for row in self.rows.values() if row.conditions.comparable(conditions)}

    def require_no_loss(self, methods: Iterable[str], conditions: Conditions) -> None:
        """See that no row would be replaced by one of fewer pairs.

        Raises:
            ConfigError: names the file and how to go on.
        """
        for method in methods:
            name = conditions.file_name(method)
            kept = self.rows.get(name)
            if kept is not None and kept.conditions.pairs > conditions.pairs:
                raise ConfigError(
                    f"{self.disk.shown(name)}: recorded from {kept.conditions.pairs} pairs, which --record "
                    f"would replace by {conditions.pairs}; measure as many, name another folder with "
                    "--records, or delete the file"
                )

    def keep(self, rows: Iterable[MeasuredRow], console: Console) -> None:
        """Write rows, over those of the same names."""
        for row in rows:
            name = row.conditions.file_name(row.method)
            self.disk.write(name, json_bytes(row.to_json()))
            console.print(f"recorded {self.disk.shown(name)}", highlight=False)
