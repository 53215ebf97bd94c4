"""Published files: the rows of some floor plans, sightings joined with their images."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import groupby
from typing import Any

import pyarrow as pa
import pyarrow.compute as pc

from rendezvous.evaluation.dataset.sampling import rows_at
from rendezvous.schema import EXPLORE, PAIRS, POSES, SIGHTINGS, VIEWS, TableSchema
from rendezvous.store.read import Item, StageReader
from rendezvous.store.records import Shard

_SIGHTING_COLUMNS = tuple(column.name for column in SIGHTINGS)
_VIEW_COLUMNS = tuple(column.name for column in VIEWS.columns if column.name not in _SIGHTING_COLUMNS)


@dataclass(frozen=True, slots=True, kw_only=True)
class PackedPlan:
    """A floor plan's rows of one published table."""

    item: Item
    view: Item | None = None  # the rows that `render` adds to the item's; None if there are none
    rows: int
    split: str

    def digests(self) -> dict[str, str]:
        """Digests of everything read for the plan."""
        view = {f"{self.item.item_id} (render)": self.view.digest} if self.view else {}
        return {self.item.item_id: self.item.digest} | view


def pairs_file(explore: StageReader, render: StageReader, plans: Sequence[PackedPlan]) -> Shard:
    """The sightings on some floor plans with their images, in the order of `explore`."""
    sightings = _plan_rows(explore, [plan.item for plan in plans], EXPLORE, _SIGHTING_COLUMNS)
    views = _plan_rows(
        render, [plan.view for plan in plans if plan.view], VIEWS, ("pair_id", "plan_id", *_VIEW_COLUMNS)
    )
    table = with_views(sightings, views)
    return Shard(table=table, counts={"pairs": table.num_rows})


def poses_file(render: StageReader, plans: Sequence[PackedPlan]) -> Shard:
    """The training images in some floor plans, in the order of `render`."""
    columns = [column.name for column in POSES.columns]
    table = _plan_rows(render, [plan.item for plan in plans], POSES, columns).select(columns)
    table = table.replace_schema_metadata(POSES.arrow().metadata)
    return Shard(table=table, counts={"poses": table.num_rows})


def with_views(sightings: pa.Table, views: pa.Table) -> pa.Table:
    """Sightings joined with rows of `VIEWS` to rows of `PAIRS`; null where a sighting has no view."""
    places = pc.index_in(sightings["pair_id"], value_set=views["pair_id"].combine_chunks())
    added = views.select(_VIEW_COLUMNS).take(places)
    for name in _VIEW_COLUMNS:
        sightings = sightings.append_column(name, added[name])
    columns = [column.name for column in PAIRS.columns]
    return sightings.select(columns).replace_schema_metadata(PAIRS.arrow().metadata)


def pairs_at(
    explore: StageReader, render: StageReader, *, sightings: pa.Table, views: pa.Table | None
) -> list[dict[str, Any]]:
    """Some complete pairs, as `PAIRS.rows` gives them."""
    by_pair = {}
    if views is not None:
        theirs = views.filter(pc.is_in(views["pair_id"], value_set=sightings["pair_id"].combine_chunks()))
        by_pair = {row["pair_id"]: row for row in rows_at(render, theirs, VIEWS)}
    unseen = dict.fromkeys(_VIEW_COLUMNS)
    return [unseen | row | by_pair.get(row["pair_id"], {}) for row in rows_at(explore, sightings, EXPLORE)]


def _plan_rows(
    reader: StageReader, items: Sequence[Item], schema: TableSchema, columns: Sequence[str]
) -> pa.Table:
    """Some columns of the rows of some floor plans, one shard in memory at a time."""
    parts = [schema.arrow().empty_table().select(columns)]
    for shard, group in groupby(items, key=lambda item: item.shard):
        table = reader.table(shard, columns=columns).select(columns).combine_chunks()
        wanted = pa.array([item.item_id for item in group])
        parts.append(table.filter(pc.is_in(table["plan_id"], value_set=wanted)))
    # In one piece, because pyarrow 26 takes wrong values from slices of nested fixed-size lists.
    return pa.concat_tables(parts).combine_chunks()
