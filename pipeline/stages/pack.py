"""Pack the sightings into the published dataset: split by floor plan, sharded, described by a card."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import groupby, takewhile
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.compute as pc

from pipeline.engine import Run, Task
from pipeline.errors import SplitError
from pipeline.evaluation.canvas import encoded_png
from pipeline.evaluation.card import CARD_COLUMNS, dataset_card, overlap_chart
from pipeline.evaluation.figures import contact_sheet
from pipeline.evaluation.sampling import SHARD, evenly_by, located_columns, rows_at
from pipeline.schema import PAIRS, SCHEMA_VERSION
from pipeline.splits import SPLITS, split_plans
from pipeline.store.disk import Disk
from pipeline.store.parquet import Layout
from pipeline.store.read import Item, StageReader, read_manifest
from pipeline.store.records import Inputs, Manifest, Shard, ShardRecord

# With camera images a row takes about 0.4 MB: row groups stay near 100 MB.
LAYOUT = Layout(item_column="plan_id", uncompressed=("map_0", "map_1", "image"), row_group_rows=256)

_PICTURED_ROWS = 3
_NAMED_FILES = 100
_ARCHIVE = re.compile(r"(.+?\.(?:tar|tar\.gz|tgz)):")


@dataclass(frozen=True, slots=True, kw_only=True)
class _PackedPlan:
    """A floor plan's sightings in one shard of `explore`."""

    item: Item
    rows: int
    split: str


def pack(run: Run) -> Manifest:
    """Publish what `explore` found as the `pairs` dataset.

    Raises:
        SplitError: a split would be empty.
        StoreError: `explore` has not finished, or its output is damaged.
    """
    section, explore = run.config.pack, run.read("explore")
    sightings = located_columns(explore, CARD_COLUMNS)
    if not sightings.num_rows:
        raise SplitError(_nothing_to_pack(explore))
    splits = split_plans(
        sightings["plan_digest"].unique().to_pylist(),
        validation_fraction=section.validation_fraction,
        test_fraction=section.test_fraction,
    )
    sightings = sightings.append_column(
        "split", pa.array([splits[digest] for digest in sightings["plan_digest"].to_pylist()])
    )
    tasks = [
        Task(
            name=f"pairs/{split}-{number:05d}-of-{len(files):05d}.parquet",
            inputs=Inputs(
                parameters=section.parameters(exclude={"rows_per_file"}),
                items={plan.item.item_id: plan.item.digest for plan in plans},
                version=SCHEMA_VERSION,
            ),
            make=partial(pack_file, explore, tuple(plan.item for plan in plans)),
        )
        for split in SPLITS
        for files in [
            _files([p for p in _plans(explore, sightings) if p.split == split], section.rows_per_file)
        ]
        for number, plans in enumerate(files)
    ]
    card = partial(_card, run, sightings)
    return run.build("pack", tasks, layout=LAYOUT, total=len(tasks), files=card)


def pack_file(explore: StageReader, items: Sequence[Item]) -> Shard:
    """The published rows of some floor plans, in their order in `explore`."""
    columns = [column.name for column in PAIRS.columns]
    parts = []
    for shard, group in groupby(items, key=lambda item: item.shard):
        table = explore.table(shard, columns=columns)
        wanted = pa.array([item.item_id for item in group])
        parts.append(table.filter(pc.is_in(table["plan_id"], value_set=wanted)))
    table = pa.concat_tables(parts).select(columns).replace_schema_metadata(PAIRS.arrow().metadata)
    return Shard(table=table, counts={"pairs": table.num_rows})


def _nothing_to_pack(explore: StageReader) -> str:
    left_out = explore.manifest().quarantined
    line = f"{explore.root}: no robots met in any episode; there is nothing to pack"
    if not left_out:
        return line
    first = left_out[0]
    return f"{line}; episodes left out: {len(left_out)}, the first: {first.item_id}: {first.reason}"


def _plans(explore: StageReader, sightings: pa.Table) -> list[_PackedPlan]:
    """The plans on which robots met, in the order of `explore`."""
    split_of = dict(zip(sightings["plan_id"].to_pylist(), sightings["split"].to_pylist(), strict=True))
    rows: dict[tuple[str, str], int] = {}
    for key in zip(sightings[SHARD].to_pylist(), sightings["plan_id"].to_pylist(), strict=True):
        rows[key] = rows.get(key, 0) + 1
    return [
        _PackedPlan(item=item, rows=rows[item.shard, item.item_id], split=split_of[item.item_id])
        for item in explore.items()
    ]


def _files(plans: Sequence[_PackedPlan], rows_per_file: int) -> list[list[_PackedPlan]]:
    """Plans in order, as many in each file as bring it to `rows_per_file`; no plan lies in two files."""
    files: list[list[_PackedPlan]] = []
    rows = rows_per_file
    for plan in plans:
        if rows >= rows_per_file:
            files.append([])
            rows = 0
        files[-1].append(plan)
        rows += plan.rows
    return files


def _card(run: Run, sightings: pa.Table, records: Sequence[ShardRecord]) -> Mapping[str, bytes]:
    """The dataset's card and its pictures."""
    explore = run.read("explore")
    shown = sightings.take(evenly_by(sightings["overlap"].to_numpy(), _PICTURED_ROWS))
    sheet = contact_sheet(
        rows_at(explore, shown),
        title="Rendezvous",
        subtitle=f"{shown.num_rows} of {sightings.num_rows} pairs, from low to high overlap",
    )
    made, manifests = explore.manifest(), _manifests(run)
    text = dataset_card(
        sightings,
        counts=made.counts(),
        left_out=made.quarantined,
        parameters=_parameters(manifests) | run.config.pack.parameters(),
        unknown=[stage for stage, manifest in manifests.items() if manifest is None],
        versions=made.shards[0].versions,
        bytes_total=sum(record.bytes for record in records),
    )
    return {
        "README.md": text.encode(),
        "pairs.png": encoded_png(sheet),
        "overlap.png": encoded_png(overlap_chart(sightings)),
    }


def _manifests(run: Run) -> dict[str, Manifest | None]:
    """Of the stages before, None where their output is gone."""
    stages = takewhile(lambda stage: stage != "pack", run.config.stages)
    return {stage: read_manifest(Disk(run.folder(stage))) for stage in stages}


def _parameters(manifests: Mapping[str, Manifest | None]) -> dict[str, Any]:
    """What the stages were run with, as their shards record it: this run may be set otherwise."""
    parameters: dict[str, Any] = {}
    for stage, manifest in manifests.items():
        if manifest is None:
            continue
        if stage == "floorplans":
            parameters |= _sources(manifest)
        for shard in manifest.shards:
            parameters |= shard.inputs.parameters
    return parameters


def _sources(floorplans: Manifest) -> dict[str, Any]:
    """Where the floor plans are from; no shard depends on that as a whole, so none records it.

    Files are told one by one if they are few, else by their folders; an archive is told as one.
    """
    # What is generated depends on the seed, what is read does not.
    inputs = [shard.inputs for shard in floorplans.shards]
    read = [_file_or_archive(name) for i in inputs if i.seed is None for name in i.items]
    sources = list(dict.fromkeys(read))
    if len(sources) > _NAMED_FILES:
        sources = list(dict.fromkeys(_folder_or_archive(source) for source in sources))
    generated = sum(len(i.items) for i in inputs if i.seed is not None)
    return {"floorplans.sources": sources, "floorplans.generate.count": generated}


def _file_or_archive(name: str) -> str:
    """What has to be named among the sources for this file to be read."""
    archive = _ARCHIVE.match(name)
    return archive[1] if archive else name


def _folder_or_archive(source: str) -> str:
    return str(Path(source).parent) if source.endswith(".json") else source
