"""Look at a stage's output: a picture of some of it, and its figures."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path

import numpy as np
import pyarrow as pa

from pipeline.errors import StoreError
from pipeline.evaluation.canvas import Image, encoded_png
from pipeline.evaluation.card import CARD_COLUMNS, quality_table
from pipeline.evaluation.figures import contact_sheet
from pipeline.evaluation.plan_figures import plan_sheet
from pipeline.evaluation.sampling import evenly_by, located_columns, rows_at
from pipeline.evaluation.tables import markdown_table
from pipeline.plan_schema import plan_of, solids_of
from pipeline.seeds import stream
from pipeline.store.read import StageReader


class Order(StrEnum):
    """Which rows to show: spread evenly from low to high overlap, or drawn at random."""

    OVERLAP = "overlap"
    RANDOM = "random"


@dataclass(frozen=True, slots=True, kw_only=True)
class Inspection:
    """What was found: a summary in Markdown, and where the picture was written."""

    summary: str
    picture: Path


def inspect(
    folder: str, *, output: Path | None = None, count: int = 6, order: Order = Order.OVERLAP, seed: int = 0
) -> Inspection:
    """Draw some of a stage's output.

    Args:
        folder: the output of `explore` or `pack` (pairs), or of `floorplans` or `meshes` (plans).
        output: PNG to write; `report/pairs.png` or `report/plans.png` by default.
        count: how many pairs or plans to show.
        order: which pairs to show.
        seed: of the random draw.

    Raises:
        StoreError: there is no such output, nothing in it, or the picture cannot be written.
    """
    reader = StageReader(folder)
    manifest = reader.manifest()
    if not manifest.rows:
        raise StoreError(f"{folder}: no rows to look at")
    figures = markdown_table(("counted", "number"), [(k, f"{v:,}") for k, v in manifest.counts().items()])
    if manifest.stage in ("floorplans", "meshes"):
        image, name = _plans(reader, count=count, seed=seed), "plans"
    else:
        sightings = located_columns(reader, CARD_COLUMNS)
        image, name = _pairs(reader, sightings, count=count, order=order, seed=seed), "pairs"
        figures = f"{figures}\n\n{quality_table(sightings)}"
    picture = output or Path("report") / f"{name}.png"
    _write(picture, encoded_png(image))
    return Inspection(summary=figures, picture=picture)


def _write(picture: Path, png: bytes) -> None:
    try:
        picture.parent.mkdir(parents=True, exist_ok=True)
        picture.write_bytes(png)
    except OSError as error:
        reason = (error.strerror or str(error)).lower()
        raise StoreError(f"{picture}: cannot be written ({reason}); --out names a PNG file") from error


def _pairs(reader: StageReader, sightings: pa.Table, *, count: int, order: Order, seed: int) -> Image:
    if order is Order.OVERLAP:
        shown = evenly_by(sightings["overlap"].to_numpy(), count)
    else:
        shown = _drawn(sightings.num_rows, count, seed)
    return contact_sheet(
        rows_at(reader, sightings.take(shown)),
        title="Rendezvous",
        subtitle=f"{len(shown)} of {sightings.num_rows} pairs in {reader.root}",
    )


def _plans(reader: StageReader, *, count: int, seed: int) -> Image:
    items = list(reader.items())
    shown = [items[i] for i in sorted(_drawn(len(items), count, seed))]
    plans = [(plan_of(row), solids_of(row.get("furniture", ()))) for row in reader.rows(shown)]
    return plan_sheet(plans, title="Floor plans", subtitle=f"{len(plans)} of {len(items)} in {reader.root}")


def _drawn(size: int, count: int, seed: int) -> list[int]:
    """Indices drawn without replacement, uniform."""
    rng: np.random.Generator = stream(seed, "inspect")
    return [int(i) for i in rng.permutation(size)[:count]]
