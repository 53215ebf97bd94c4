"""What evaluations keep: the report, of which each replaces its own part, and recorded figures."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Generic

from rich.console import Console

from rendezvous.errors import ConfigError, StoreError
from rendezvous.evaluation.report.page import PARTS, ReportPart, report_page
from rendezvous.evaluation.report.recorded_figures import Recordable, Row, read_recorded
from rendezvous.store.disk import Disk
from rendezvous.store.read import read_json
from rendezvous.store.records import json_bytes

PAGE, METRICS = "index.html", "metrics.json"


def part_name(key: str) -> str:
    """The file with an evaluation's part of the page."""
    return f"parts/{key}.json"


def with_sources(rows: Mapping[str, Recordable], measured: Collection[str]) -> dict[str, Any]:
    """Rows for `metrics.json`, each with whether it was measured in this run or recorded."""
    return {
        name: {**row.to_json(), "source": "measured" if name in measured else "recorded"}
        for name, row in rows.items()
    }


def kept_metrics(disk: Disk) -> dict[str, Any]:
    """Figures of all evaluations, by key; none if there are none yet.

    Raises:
        StoreError: the file is damaged.
    """
    try:
        return read_json(disk, METRICS) or {}
    except StoreError as error:
        raise StoreError(f"{error} once that file is deleted") from error


def keep_evaluation(disk: Disk, part: ReportPart, figures: Mapping[str, Any], console: Console) -> None:
    """Keep what an evaluation found, and write the page of all evaluations; the page comes last.

    A damaged or missing part of another evaluation is reported on the console and on the page.

    Raises:
        StoreError: `metrics.json` is damaged, or nothing can be written.
    """
    metrics = {**kept_metrics(disk), part.key: figures}
    disk.write(METRICS, json_bytes(metrics))
    disk.write(part_name(part.key), json_bytes(part.to_json()))
    parts: list[ReportPart] = []
    absent: list[str] = []
    for key in PARTS:
        if key not in metrics and disk.size(part_name(key)) is None:
            continue
        try:
            parts.append(_read_part(disk, key))
        except StoreError as error:
            absent.append(key)
            console.print(
                f"report: warning: {error}; the page is without it until that evaluation is run again",
                highlight=False,
                soft_wrap=True,
            )
    disk.write(PAGE, report_page(parts, absent=absent).encode())


def _read_part(disk: Disk, key: str) -> ReportPart:
    name = part_name(key)
    values = read_json(disk, name)
    if values is None:
        raise StoreError(f"{disk.shown(name)}: missing")
    return ReportPart.from_json(values, key=key, where=disk.shown(name))


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
