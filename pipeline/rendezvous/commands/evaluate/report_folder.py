"""The folder of the report: figures and page of all evaluations, each of which replaces its own."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Any

from rich.console import Console

from rendezvous.errors import StoreError
from rendezvous.evaluation.report.page import PARTS, ReportPart, report_page
from rendezvous.evaluation.report.recorded_figures import Recordable
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
