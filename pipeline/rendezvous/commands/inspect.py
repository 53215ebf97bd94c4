"""Inspect a stage's output: pictures of some of its rows, and its figures."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path

import pyarrow as pa
import pyarrow.compute as pc

from rendezvous.errors import ConfigError, StoreError
from rendezvous.evaluation.dataset.card import CARD_COLUMNS, quality_table
from rendezvous.evaluation.dataset.pose_card import POSE_COLUMNS, VIEW_COLUMNS, pose_quality_table
from rendezvous.evaluation.dataset.sampling import evenly_by, located_columns, rows_at
from rendezvous.evaluation.dataset.tables import markdown_table, quantile_table
from rendezvous.evaluation.pictures.canvas import encoded_png
from rendezvous.evaluation.pictures.pairs import contact_sheet
from rendezvous.evaluation.pictures.plans import plan_sheet
from rendezvous.evaluation.pictures.poses import pose_sheet
from rendezvous.geometry.camera import Image
from rendezvous.plan_schema import plan_of, solids_of
from rendezvous.schema import PAIRS, POSES, VIEWS, TableSchema
from rendezvous.seeds import stream
from rendezvous.store.read import StageReader

Looked = tuple[dict[str, Image], list[str]]  # pictures by name, and sections of figures in Markdown


class Order(StrEnum):
    """How rows are chosen: spread evenly from low to high overlap or visibility, or drawn at random."""

    OVERLAP = "overlap"
    VISIBILITY = "visibility"
    RANDOM = "random"


class ShownTable(StrEnum):
    """The tables that a stage may have: `explore` and `pack` have pairs, `render` has views."""

    PAIRS = "pairs"
    VIEWS = "views"
    POSES = "poses"


@dataclass(frozen=True, slots=True, kw_only=True)
class Inspection:
    """A summary in Markdown, and the pictures that were written."""

    summary: str
    pictures: tuple[Path, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class Selection:
    """Which rows to show."""

    count: int | None = None  # how many, or None for as many as make a good sheet
    order: Order | None = None  # how they are chosen, or None for pairs by overlap and images by visibility
    seed: int = 0  # of the random draw


@dataclass(frozen=True, slots=True, kw_only=True)
class _Look:
    """How a table is shown."""

    schema: TableSchema  # of its rows
    columns: tuple[str, ...]  # those that figures and order are computed from
    # title, sheet: title of its picture, and what draws it.
    title: str
    sheet: Callable[..., Image]
    # count, order: default number of rows and their order.
    count: int
    order: Order
    figures: Callable[[pa.Table], str]  # a Markdown section of its columns


def inspect(
    folder: str,
    *,
    output: Path | None = None,
    table: ShownTable | None = None,
    selection: Selection = Selection(),
) -> Inspection:
    """Draw some of a stage's output.

    Args:
        folder: the output of `explore` or `pack` (pairs, poses), of `render` (views, poses), or of
            `floorplans` or `meshes` (plans).
        output: PNG to write, by default one per table in `report/`.
        table: table to show, by default all.
        selection: rows to show.

    Raises:
        StoreError: the output is missing or has no rows, or a picture cannot be written.
        ConfigError: the output has no such table or order, or `output` would have to hold several pictures.
    """
    reader = StageReader(folder)
    manifest = reader.manifest()
    if not manifest.rows:
        raise StoreError(f"{folder}: no rows to look at")
    counts = markdown_table(("counted", "number"), [(k, f"{v:,}") for k, v in manifest.counts().items()])
    look = _plans if manifest.stage in ("floorplans", "meshes") else _tables
    images, sections = look(reader, table, selection)
    if output is not None and len(images) > 1:
        raise ConfigError(f"--out names one picture; choose --table {' or '.join(images)}")
    pictures = [output or Path("report") / f"{name}.png" for name in images]
    for picture, image in zip(pictures, images.values(), strict=True):
        _write(picture, encoded_png(image))
    return Inspection(summary="\n\n".join([counts, *sections]), pictures=tuple(pictures))


def _tables(reader: StageReader, table: ShownTable | None, selection: Selection) -> Looked:
    """Pictures and figures of all tables, or of one."""
    there = _folders(reader)
    if table is not None and table not in there:
        raise ConfigError(f"--table is '{table}'; {reader.root} has {' and '.join(there)}")
    images: dict[str, Image] = {}
    sections: list[str] = []
    for name in there if table is None else (table,):
        look = _LOOKS[name]
        # `explore`, whose shards lie in no folder, takes no images.
        columns = located_columns(reader, look.columns if there[name] else CARD_COLUMNS, under=there[name])
        shown = columns.take(_selected(columns, look, selection))
        images[str(name)] = look.sheet(
            rows_at(reader, shown, look.schema),
            title=look.title,
            subtitle=f"{shown.num_rows:,} of {columns.num_rows:,} {name} in {reader.root}",
        )
        sections.append(f"## {name.capitalize()}\n\n{look.figures(columns)}")
    return images, sections


def _folders(reader: StageReader) -> dict[ShownTable, str]:
    """The tables that have rows, and the folders of their shards."""
    found = {
        table: f"{table}/" for table in ShownTable if any(shard.rows for shard in reader.shards(f"{table}/"))
    }
    # `explore` writes one table, and no folder.
    return found or {ShownTable.PAIRS: ""}


def _write(picture: Path, png: bytes) -> None:
    try:
        picture.parent.mkdir(parents=True, exist_ok=True)
        picture.write_bytes(png)
    except OSError as error:
        reason = (error.strerror or str(error)).lower()
        raise StoreError(f"{picture}: cannot be written ({reason}); --out names a PNG file") from error


def _selected(columns: pa.Table, look: _Look, selection: Selection) -> list[int]:
    """Indices of the rows to show."""
    count, order = selection.count or look.count, selection.order or look.order
    if order is Order.RANDOM:
        return _drawn(columns.num_rows, count, selection.seed)
    # A table may lack the column, and pairs without an image are null in it.
    known = pc.indices_nonzero(columns[order].is_valid()) if order in columns.column_names else []
    if not len(known):
        raise ConfigError(
            f"--order is '{order}', which no {look.schema.name} here have; "
            "--table chooses others, random suits all"
        )
    return [known[rank].as_py() for rank in evenly_by(columns[order].drop_null().to_numpy(), count)]


def _plans(reader: StageReader, table: ShownTable | None, selection: Selection) -> Looked:
    """A picture of plans, which have no figures beside their counts."""
    if table is not None:
        raise ConfigError(f"--table is '{table}'; {reader.root} has only plans")
    items = list(reader.items())
    shown = [items[i] for i in sorted(_drawn(len(items), selection.count or _PLANS, selection.seed))]
    plans = [(plan_of(row), solids_of(row.get("furniture", ()))) for row in reader.rows(shown)]
    subtitle = f"{len(plans)} of {len(items)} in {reader.root}"
    return {"plans": plan_sheet(plans, title="Floor plans", subtitle=subtitle)}, []


def _drawn(size: int, count: int, seed: int) -> list[int]:
    """Indices drawn uniformly without replacement."""
    return [int(i) for i in stream(seed, "inspect").permutation(size)[:count]]


def _pair_figures(pairs: pa.Table) -> str:
    """The card's quality figures, and the visibility in the pairs that have an image."""
    figures = quality_table(pairs)
    if "visibility" not in pairs.column_names or not (known := pairs["visibility"].drop_null()):
        return figures
    return f"{figures}\n\n{quantile_table([('Visibility in the images', known.to_numpy(), 2)])}"


def _pose_figures(poses: pa.Table) -> str:
    """Counts of images by mode and without a robot, and their quality figures."""
    modes = sorted(poses["mode"].to_pylist())
    rows = [(f"`{mode}`", f"{modes.count(mode):,}") for mode in dict.fromkeys(modes)]
    rows.append(("without robot", f"{poses['T_c_o'].null_count / poses.num_rows:.1%}"))
    return f"{markdown_table(('images', 'number'), rows)}\n\n{pose_quality_table(poses)}"


_PLANS = 6
_LOOKS = {
    ShownTable.PAIRS: _Look(
        schema=PAIRS,
        columns=(*CARD_COLUMNS, "visibility"),
        title="Rendezvous",
        sheet=contact_sheet,
        count=6,
        order=Order.OVERLAP,
        figures=_pair_figures,
    ),
    ShownTable.VIEWS: _Look(
        schema=VIEWS,
        columns=(*VIEW_COLUMNS, "T_c_o"),
        title="Rendezvous, as robot 0 sees them",
        sheet=pose_sheet,
        count=24,
        order=Order.VISIBILITY,
        figures=pose_quality_table,
    ),
    ShownTable.POSES: _Look(
        schema=POSES,
        columns=POSE_COLUMNS,
        title="Training images",
        sheet=pose_sheet,
        count=24,
        order=Order.VISIBILITY,
        figures=_pose_figures,
    ),
}
