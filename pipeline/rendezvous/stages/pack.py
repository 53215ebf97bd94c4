"""Pack sightings and images into the published dataset: split by floor plan, sharded, described by a card."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial

import pyarrow as pa

from rendezvous.config.sections import PackSection
from rendezvous.engine.run import Run, Task
from rendezvous.errors import SplitError, StoreError
from rendezvous.evaluation.dataset.card import CARD_COLUMNS
from rendezvous.evaluation.dataset.pose_card import POSE_COLUMNS, VIEW_COLUMNS
from rendezvous.evaluation.dataset.sampling import SHARD, located_columns
from rendezvous.plan_schema import PLAN_COLUMNS, plan_of
from rendezvous.schema import PAIRS, POSES, SCHEMA_VERSION, TableSchema
from rendezvous.splits import SPLITS, split_of, split_plans
from rendezvous.stages.dataset.dataset_card import Contents, card_files
from rendezvous.stages.dataset.published import PackedPlan, pairs_file, poses_file
from rendezvous.store.read import Item, StageReader
from rendezvous.store.records import Inputs, Manifest, Shard
from rendezvous.store.tables import Layout, column_types

# With camera images a row takes about 0.4 MB: row groups stay near 100 MB.
LAYOUT = Layout(item_column="plan_id", uncompressed=("map_0", "map_1", "image"), row_group_rows=256)

_VIEWS, _POSES = "views/", "poses/"


def pack(run: Run) -> Manifest:
    """Publish what `explore` found and `render` made of it, as the tables `pairs` and `poses`.

    Raises:
        SplitError: a split would be empty.
        StoreError: `explore` or `render` has not finished, or its output is damaged or of another `explore`.
    """
    section, explore, render = run.config.pack, run.read("explore"), run.read("render")
    sightings = located_columns(explore, CARD_COLUMNS)
    if not sightings.num_rows:
        raise SplitError(_nothing_to_pack(explore))
    views = _rendered(render, VIEW_COLUMNS, _VIEWS)
    poses = _rendered(render, POSE_COLUMNS, _POSES)
    splits = {} if poses is None else _splits(section, "poses", poses["plan_digest"].unique().to_pylist())
    # Without views the images are what the dataset is for: a split may have images and no pairs.
    only_images = poses is not None and views is None
    splits |= _splits(
        section, "pairs", sightings["plan_digest"].unique().to_pylist(), required=not only_images
    )
    contents = Contents(
        sightings=_with_split(sightings, splits),
        views=views,
        poses=None if poses is None else _with_split(poses, splits),
    )
    sighted = _plans(explore.items(), contents.sightings, _views(explore, render))
    posed = [] if contents.poses is None else _plans(render.items(_POSES), contents.poses, {})
    tasks = [
        *_tasks(section, PAIRS, sighted, partial(pairs_file, explore, render)),
        *_tasks(section, POSES, posed, partial(poses_file, render)),
    ]
    card = partial(card_files, run, contents)
    return run.build("pack", tasks, layout=LAYOUT, total=len(tasks), files=card)


def _nothing_to_pack(explore: StageReader) -> str:
    left_out = explore.manifest().quarantined
    line = f"{explore.root}: no robots met in any episode; there is nothing to pack"
    if not left_out:
        return line
    first = left_out[0]
    return f"{line}; episodes left out: {len(left_out)}, the first: {first.item_id}: {first.reason}"


def _rendered(render: StageReader, columns: Sequence[str], under: str) -> pa.Table | None:
    """Some columns of one table of `render`; None if it has no rows."""
    table = located_columns(render, columns, under=under) if render.shards(under) else None
    return table if table is not None and table.num_rows else None


def check_splits(section: PackSection, floorplans: StageReader) -> None:
    """Check early that no split would be empty if robots met on every floor plan.

    Raises:
        SplitError: one would.
        StoreError: `floorplans` has not finished, or its output is damaged.
    """
    plans = floorplans.rows(columns=PLAN_COLUMNS)
    _splits(section, "floorplans", [plan_of(row).digest() for row in plans])


def _splits(
    section: PackSection, table: str, plan_digests: Iterable[str], *, required: bool = True
) -> dict[str, str]:
    """The split of each plan of a table, by its digest; required: none may be empty."""
    shares = {
        "validation_fraction": section.validation_fraction,
        "test_fraction": section.test_fraction,
    }
    if not required:
        return {digest: split_of(digest, **shares) for digest in plan_digests}
    try:
        return split_plans(plan_digests, **shares)
    except SplitError as error:
        raise SplitError(f"{table}: {error}") from error


def _with_split(rows: pa.Table, splits: Mapping[str, str]) -> pa.Table:
    return rows.append_column("split", pa.array([splits[d] for d in rows["plan_digest"].to_pylist()]))


def _views(explore: StageReader, render: StageReader) -> dict[str, Item]:
    """The images of the sightings, by plan."""
    shards = render.shards(_VIEWS)
    taken_of = {plan_id: digest for shard in shards for plan_id, digest in shard.inputs.items.items()}
    for item in explore.items():
        if shards and taken_of.get(item.item_id) != item.digest:
            raise StoreError(
                f"{render.root}: its images of {item.item_id!r} were not taken of the sightings in "
                f"{explore.root}; run `rendezvous render` again"
            )
    return {item.item_id: item for item in render.items(_VIEWS)}


def _plans(items: Iterable[Item], rows: pa.Table, views: Mapping[str, Item]) -> list[PackedPlan]:
    split_of = dict(zip(rows["plan_id"].to_pylist(), rows["split"].to_pylist(), strict=True))
    counts = Counter(zip(rows[SHARD].to_pylist(), rows["plan_id"].to_pylist(), strict=True))
    return [
        PackedPlan(
            item=item,
            view=views.get(item.item_id),
            rows=counts[item.shard, item.item_id],
            split=split_of[item.item_id],
        )
        for item in items
    ]


def _tasks(
    section: PackSection,
    table: TableSchema,
    plans: Sequence[PackedPlan],
    make: Callable[[Sequence[PackedPlan]], Shard],
) -> list[Task]:
    """The files of one published table, split by split."""
    tasks = []
    for split in SPLITS:
        files = _files([plan for plan in plans if plan.split == split], section.rows_per_file)
        for number, of_file in enumerate(files):
            inputs = Inputs(
                parameters=section.parameters(exclude={"rows_per_file"}),
                columns=column_types(table.arrow()),
                items={name: digest for plan in of_file for name, digest in plan.digests().items()},
                version=SCHEMA_VERSION,
            )
            name = f"{table.name}/{split}-{number:05d}-of-{len(files):05d}.parquet"
            tasks.append(Task(name=name, inputs=inputs, make=partial(make, tuple(of_file))))
    return tasks


def _files(plans: Sequence[PackedPlan], rows_per_file: int) -> list[list[PackedPlan]]:
    """Plans in order, as many in each file as bring it to `rows_per_file`; no plan lies in two files."""
    files: list[list[PackedPlan]] = []
    rows = rows_per_file
    for plan in plans:
        if rows >= rows_per_file:
            files.append([])
            rows = 0
        files[-1].append(plan)
        rows += plan.rows
    return files
