"""The dataset's card: what is in it, how it was made, how good it is."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from rendezvous.evaluation.dataset.charts import histogram
from rendezvous.evaluation.dataset.pose_card import licence_note, poses_section, views_section
from rendezvous.evaluation.dataset.quantiles import quantile_table
from rendezvous.evaluation.dataset.tables import column_table, markdown_table
from rendezvous.evaluation.pictures.canvas import Image
from rendezvous.geometry.se2 import Array
from rendezvous.schema import PAIRS, POSES, SCHEMA_VERSION
from rendezvous.splits import SPLITS
from rendezvous.store.records import Quarantined

_ROBOTS = ("0", "1")
_PAPERS_OVERLAP = 0.174
_TOLD_LEFT_OUT = 3
_OVERLAP_EDGES = np.linspace(0.0, 1.0, 21)

# Title, columns (pooled), factor and unit it is shown in, decimals.
_MEASURES: tuple[tuple[str, tuple[str, ...], float, str, int], ...] = (
    ("SLAM position error", tuple(f"slam_position_error_{i}_m" for i in _ROBOTS), 100.0, "cm", 1),
    ("SLAM heading error", tuple(f"slam_heading_error_{i}_rad" for i in _ROBOTS), 180.0 / np.pi, "°", 2),
    ("Odometry position error", tuple(f"odometry_position_error_{i}_m" for i in _ROBOTS), 100.0, "cm", 1),
    (
        "Odometry heading error",
        tuple(f"odometry_heading_error_{i}_rad" for i in _ROBOTS),
        180 / np.pi,
        "°",
        2,
    ),
    ("Walls that agree, by `T_m0_m1_local`", ("wall_agreement_local",), 100.0, "%", 1),
    ("Walls that agree, by `T_m0_m1`", ("wall_agreement",), 100.0, "%", 1),
    ("Overlap", ("overlap",), 1.0, "", 3),
    ("Occupied cells per map", tuple(f"occupied_cells_{i}" for i in _ROBOTS), 1.0, "", 0),
    ("Of those, ghosts of the other robot", tuple(f"ghost_cells_{i}" for i in _ROBOTS), 1.0, "", 0),
    ("Range of the sighting", ("range_m",), 1.0, "m", 2),
    ("Time of the sighting", ("t_s",), 1.0, "s", 0),
)

CARD_COLUMNS = (
    "seed",
    "plan_id",
    "plan_digest",
    "episode_id",
    "event_id",
    "pair_id",
    "visible_fraction",
    *(name for _, names, *_ in _MEASURES for name in names),
)
"""What the card is computed from."""


def dataset_card(
    sightings: pa.Table,
    poses: pa.Table | None,
    *,
    counts: Mapping[str, int],
    left_out: Sequence[Quarantined],
    poses_left_out: Sequence[Quarantined],
    parameters: Mapping[str, Any],
    unknown: Sequence[str],
    versions: Mapping[str, str],
    bytes_total: int,
) -> str:
    """The card, Markdown with the YAML header that Hugging Face reads.

    Args:
        sightings: `CARD_COLUMNS` of all pairs, their `split`, and the `visibility` in their image, null
            where there is none.
        poses: `POSE_COLUMNS` of all training images and their `split`; None if there are none.
        counts: what `explore` counted, met or not.
        left_out: episodes that could not be run.
        poses_left_out: training images that could not be made.
        parameters: all that the rows depend on, by dotted key; `explore.robot.name` is among them.
        unknown: stages whose parameters are not, because their output is gone.
        versions: of the packages that the rows were made with.
        bytes_total: size of the Parquet files.
    """
    has_images = poses is not None or sightings["visibility"].null_count < sightings.num_rows
    sections = [
        _yaml_header(sightings, poses),
        _INTRODUCTION.format(robot=parameters["explore.robot.name"], split=_splits(sightings)[0])
        + ("```" if poses is None else _LOADED_POSES.format(split=_splits(poses)[0])),
        f"## Splits\n\n{_split_table(sightings)}\n\nNo floor plan is in two splits: a plan's split is a "
        f"hash of its geometry. {bytes_total / 1e6:.1f} MB in all.",
        f"## Episodes\n\n{_counts_table(counts)}{_left_out_list('Episodes', left_out)}",
        f"## Overlap\n\n![Histogram of the overlap](overlap.png)\n\n{_overlap_table(sightings)}",
        f"## Quality\n\n{quality_table(sightings)}\n\n{_QUALITY_NOTE}",
        views_section(sightings),
        *([] if poses is None else [poses_section(poses) + _left_out_list("Images", poses_left_out)]),
        f"## Columns of `pairs`\n\n{_COLUMNS_NOTE}\n\n{column_table(PAIRS)}",
        *([] if poses is None else [f"## Columns of `poses`\n\n{column_table(POSES)}"]),
        *([f"## Licences of the images\n\n{licence_note(parameters)}"] if has_images else []),
        f"## How it was made\n\n{_origin(_seeds(sightings, poses), versions, unknown)}",
        f"<details><summary>All parameters</summary>\n\n{_parameter_table(parameters)}\n\n</details>",
    ]
    return "\n\n".join(sections) + "\n"


_INTRODUCTION = """# Rendezvous

Two simulated robots, each a `{robot}`, explore a furnished building, each with its own SLAM map, until one
sees the other. Every row of `pairs` is one such sighting: both occupancy grids, both estimated poses, the
true relative pose, the transform between the maps, and what the camera saw.

![Three of the pairs: each robot's map, and both aligned](pairs.png)

```python
from datasets import load_dataset

pairs = load_dataset("path/to/this/folder", split="{split}")
"""

_LOADED_POSES = """poses = load_dataset("path/to/this/folder", "poses", split="{split}")
```"""

_QUALITY_NOTE = """\
Columns are quantiles; errors are those at the sighting, both robots pooled. Walls agree where an occupied
cell of one map that lies in the known area of the other is within 0.10 m of an occupied cell there.
`T_m0_m1_local` is built from the SLAM poses at the meeting and is the label to learn; `T_m0_m1` comes from
the true starts and contains the drift of both maps."""

_COLUMNS_NOTE = """\
SE(2) poses are x [m], y [m], yaw [rad]; `T_a_b` is the pose of frame b in frame a. m0, m1: the robots' map
frames, each one's true start pose; r0, r1: the robots, on the floor between the wheels, x forward; c: camera,
x right, y down, z forward; o: centre of the seen robot's cuboid; w: the floor plan."""

_ORIGIN_NOTE = """\
The same versions, seed and floor plan files make the same rows again with the parameters below: those of
`stages.yaml`, by their full key. `explore.robot` and `meshes.robot` are written out as the robot file that
they name; `render.robot.model` is a digest of its looks, `render.backgrounds` one of the photos.
`plans_per_shard` is missing because no row depends on it."""


def overlap_chart(sightings: pa.Table) -> Image:
    """Histogram of the overlap, with the paper's real scenario marked."""
    return histogram(
        sightings["overlap"].to_numpy(),
        _OVERLAP_EDGES,
        title="Overlap of the two maps, pairs per bin",
        mark=_PAPERS_OVERLAP,
        mark_label=f"the paper's real scenario, {_PAPERS_OVERLAP}",
    )


def _yaml_header(sightings: pa.Table, poses: pa.Table | None) -> str:
    configs = _yaml_config("pairs", sightings, default=True)
    rows = sightings.num_rows
    if poses is not None:
        configs += _yaml_config("poses", poses)
        rows += poses.num_rows
    tags = ("robotics", "slam", "map-fusion", "occupancy-grid", "multi-robot", "pose-estimation")
    tag_lines = "".join(f"- {tag}\n" for tag in tags)
    return (
        "---\npretty_name: Rendezvous\n"
        f"tags:\n{tag_lines}"
        f"size_categories:\n- {_size_category(rows)}\n"
        f"configs:\n{configs}---"
    )


def _yaml_config(name: str, rows: pa.Table, *, default: bool = False) -> str:
    files = [f"  - split: {s}\n    path: {name}/{s}-*.parquet\n" for s in _splits(rows)]
    first = "  default: true\n" if default else ""
    return f"- config_name: {name}\n{first}  data_files:\n{''.join(files)}"


def _splits(rows: pa.Table) -> list[str]:
    """Those that have rows."""
    present = set(rows["split"].unique().to_pylist())
    return [split for split in SPLITS if split in present]


def _size_category(rows: int) -> str:
    bounds = [(10**3, "n<1K"), (10**4, "1K<n<10K"), (10**5, "10K<n<100K"), (10**6, "100K<n<1M")]
    return next((name for bound, name in bounds if rows < bound), "1M<n<10M")


def _split_table(sightings: pa.Table) -> str:
    counted = ("plan_digest", "episode_id", "event_id")
    rows = []
    for split in SPLITS:
        part = sightings.filter(pc.field("split") == split)
        if part.num_rows:
            rows.append((split, *(len(part[name].unique()) for name in counted), part.num_rows))
    totals = ("all", *(sum(row[i] for row in rows) for i in range(1, 5)))
    return markdown_table(("split", "floor plans", "episodes", "meetings", "pairs"), [*rows, totals])


def _counts_table(counts: Mapping[str, int]) -> str:
    return markdown_table(("counted", "number"), [(k.replace("_", " "), f"{v:,}") for k, v in counts.items()])


def _left_out_list(what: str, left_out: Sequence[Quarantined]) -> str:
    """How many are missing, and some of the reasons; empty if none is."""
    if not left_out:
        return ""
    told = list({entry.reason: entry for entry in left_out}.values())[:_TOLD_LEFT_OUT]
    reasons = "\n".join(f"- `{entry.item_id}`: {entry.reason}" for entry in told)
    return f"\n\n{what} left out, because they could not be made: {len(left_out)}. Reasons:\n\n{reasons}"


def _seeds(sightings: pa.Table, poses: pa.Table | None) -> str:
    """The root seeds of all rows: one, unless a stage was run again with another."""
    tables = [sightings] if poses is None else [sightings, poses]
    return ", ".join(str(s) for s in sorted({s for t in tables for s in t["seed"].unique().to_pylist()}))


def _origin(seeds: str, versions: Mapping[str, str], unknown: Sequence[str]) -> str:
    """What makes the same rows again."""
    packages = ", ".join(f"{name} {version}" for name, version in versions.items())
    gone = ", ".join(f"`{stage}`" for stage in unknown)
    missing = f"\n\nNot known, because its output was gone: the parameters of {gone}." if unknown else ""
    return f"Root seed {seeds}, schema version {SCHEMA_VERSION}, {packages}.\n\n{_ORIGIN_NOTE}{missing}"


def _overlap_table(sightings: pa.Table) -> str:
    overlap = sightings["overlap"].to_numpy()
    numbers, _ = np.histogram(overlap, _OVERLAP_EDGES)
    rows = [
        (f"{low:.2f} – {high:.2f}", number, f"{number / len(overlap):.1%}")
        for low, high, number in zip(_OVERLAP_EDGES[:-1], _OVERLAP_EDGES[1:], numbers, strict=True)
        if number
    ]
    table = markdown_table(("overlap", "pairs", "share"), rows)
    return f"{table}\n\n{np.mean(overlap < 0.25):.1%} of the pairs overlap by less than 0.25."


def quality_table(sightings: pa.Table) -> str:
    """Quantiles of what `CARD_COLUMNS` measure."""
    return quantile_table(
        [
            (f"{title} [{unit}]" if unit else title, factor * _pooled(sightings, names), decimals)
            for title, names, factor, unit, decimals in _MEASURES
        ]
    )


def _pooled(sightings: pa.Table, names: Sequence[str]) -> Array:
    columns = [sightings[name].drop_null().to_numpy().astype(np.float64) for name in names]
    return np.concatenate(columns)


def _parameter_table(parameters: Mapping[str, Any]) -> str:
    rows = [(f"`{key}`", f"`{json.dumps(value)}`") for key, value in parameters.items()]
    return markdown_table(("parameter", "value"), rows)
