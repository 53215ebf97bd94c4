"""The files beside the published tables: the dataset's card and its pictures."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.compute as pc

from rendezvous.config.stage_table import DATASET_STAGES
from rendezvous.engine.run import Run
from rendezvous.evaluation.dataset.card import dataset_card, overlap_chart
from rendezvous.evaluation.dataset.sampling import evenly_by, rows_at
from rendezvous.evaluation.pictures.canvas import encoded_png
from rendezvous.evaluation.pictures.pairs import contact_sheet
from rendezvous.evaluation.pictures.poses import pose_sheet
from rendezvous.schema import POSES
from rendezvous.stages.dataset.published import pairs_at
from rendezvous.store.disk import Disk
from rendezvous.store.read import read_manifest
from rendezvous.store.records import Manifest, ShardRecord

_PICTURED_PAIRS, _PICTURED_POSES = 3, 12
_NAMED_FILES = 100
_IN_ARCHIVE = re.compile(r"^(.+?\.(?:tar|tar\.gz|tgz)):.*", re.DOTALL)


@dataclass(frozen=True, slots=True, kw_only=True)
class Contents:
    """The published tables with their rows' places, as far as the card needs them; None without rows."""

    sightings: pa.Table  # with their `split`, as are `poses`
    views: pa.Table | None
    poses: pa.Table | None


def card_files(run: Run, contents: Contents, records: Sequence[ShardRecord]) -> Mapping[str, bytes]:
    """The dataset's card and its pictures, by name."""
    made, rendered = run.read("explore").manifest(), run.read("render").manifest()
    # None if a stage's output is gone.
    manifests = {stage: read_manifest(Disk(run.folder(stage))) for stage in DATASET_STAGES if stage != "pack"}
    sightings = _with_visibility(contents)
    text = dataset_card(
        sightings,
        contents.poses,
        counts=made.counts(),
        left_out=made.quarantined,
        poses_left_out=rendered.quarantined,
        parameters=_parameters(manifests) | run.config.pack.parameters(),
        unknown=[stage for stage, manifest in manifests.items() if manifest is None],
        versions=made.shards[0].versions,
        bytes_total=sum(record.bytes for record in records),
    )
    files = {
        "README.md": text.encode(),
        "pairs.png": _pairs_picture(run, contents),
        "overlap.png": encoded_png(overlap_chart(sightings)),
    }
    return files if contents.poses is None else files | {"poses.png": _poses_picture(run, contents.poses)}


def _with_visibility(contents: Contents) -> pa.Table:
    """The sightings with the `visibility` in their images; null without an image."""
    sightings, views = contents.sightings, contents.views
    if views is None:
        return sightings.append_column("visibility", pa.nulls(sightings.num_rows, pa.float64()))
    places = pc.index_in(sightings["pair_id"], value_set=views["pair_id"].combine_chunks())
    return sightings.append_column("visibility", views["visibility"].take(places))


def _pairs_picture(run: Run, contents: Contents) -> bytes:
    sightings = contents.sightings
    shown = sightings.take(evenly_by(sightings["overlap"].to_numpy(), _PICTURED_PAIRS))
    rows = pairs_at(run.read("explore"), run.read("render"), sightings=shown, views=contents.views)
    subtitle = f"{len(rows)} of {sightings.num_rows} pairs, from low to high overlap"
    return encoded_png(contact_sheet(rows, title="Rendezvous", subtitle=subtitle))


def _poses_picture(run: Run, poses: pa.Table) -> bytes:
    shown = poses.take(evenly_by(poses["visibility"].to_numpy(), _PICTURED_POSES))
    rows = rows_at(run.read("render"), shown, POSES)
    subtitle = f"{len(rows)} of {poses.num_rows} training images, from hidden to fully visible"
    return encoded_png(pose_sheet(rows, title="Poses", subtitle=subtitle))


def _parameters(manifests: Mapping[str, Manifest | None]) -> dict[str, Any]:
    """The parameters recorded in the stages' shards; those of this run may differ."""
    parameters: dict[str, Any] = {}
    for stage, manifest in manifests.items():
        if manifest is None:
            continue
        if stage == "floorplans":
            parameters |= _sources(manifest)
        if stage == "render":
            parameters |= _tables(manifest)
        for shard in manifest.shards:
            parameters |= shard.inputs.parameters
    # The robot of `render` is that of `explore`.
    repeated = {
        f"render.{key.removeprefix('explore.')}" for key in parameters if key.startswith("explore.robot.")
    }
    return {key: value for key, value in parameters.items() if key not in repeated}


def _sources(floorplans: Manifest) -> dict[str, Any]:
    """The sources of the floor plans, which no shard records, from the names of the candidates.

    Up to `_NAMED_FILES` files are named one by one, more by their folders; an archive counts as one.
    """
    # What is generated depends on the seed, what is read does not.
    inputs = [shard.inputs for shard in floorplans.shards]
    read = [_IN_ARCHIVE.sub(r"\1", name) for i in inputs if i.seed is None for name in i.items]
    sources = list(dict.fromkeys(read))
    if len(sources) > _NAMED_FILES:
        folders = [str(Path(name).parent) if name.endswith(".json") else name for name in sources]
        sources = list(dict.fromkeys(folders))
    generated = sum(len(i.items) for i in inputs if i.seed is not None)
    return {"floorplans.sources": sources, "floorplans.generate.count": generated}


def _tables(render: Manifest) -> dict[str, Any]:
    """Which tables were rendered; no shard records that."""
    tables = {shard.name.split("/")[0] for shard in render.shards}
    return {"render.views": "views" in tables} | ({} if "poses" in tables else {"render.poses_per_plan": 0})
