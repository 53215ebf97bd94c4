"""The dataset's card: what is in it, how it was made, how good it is."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pyarrow as pa

from rendezvous.evaluation.dataset.pose_card import licence_note, poses_section, views_section
from rendezvous.evaluation.dataset.tables import (
    column_table,
    distinct,
    markdown_table,
    quantile_table,
    split_table,
)
from rendezvous.evaluation.pictures.canvas import BLUE, INK, MUTED, RED, Canvas
from rendezvous.geometry.camera import Image
from rendezvous.geometry.se2 import Array
from rendezvous.schema import PAIRS, POSES, SCHEMA_VERSION
from rendezvous.splits import SPLITS
from rendezvous.store.records import Quarantined

_PAPERS_OVERLAP = 0.174
_CHART_WIDTH_PX, _CHART_HEIGHT_PX = 1240, 460
_LEFT_PX, _TOP_PX, _BOTTOM_PX = 28, 70, 60
_REASONS_SHOWN = 3
_OVERLAP_EDGES = np.linspace(0.0, 1.0, 21)
_DEGREES = 180.0 / np.pi

# Title, column (of both robots, where it has braces), factor and unit to show it in, decimals.
_MEASURES: tuple[tuple[str, str, float, str, int], ...] = (
    ("SLAM position error", "slam_position_error_{}_m", 100.0, "cm", 1),
    ("SLAM heading error", "slam_heading_error_{}_rad", _DEGREES, "°", 2),
    ("Odometry position error", "odometry_position_error_{}_m", 100.0, "cm", 1),
    ("Odometry heading error", "odometry_heading_error_{}_rad", _DEGREES, "°", 2),
    ("Walls that agree, by `T_m0_m1_local`", "wall_agreement_local", 100.0, "%", 1),
    ("Walls that agree, by `T_m0_m1`", "wall_agreement", 100.0, "%", 1),
    ("Overlap", "overlap", 1.0, "", 3),
    ("Occupied cells per map", "occupied_cells_{}", 1.0, "", 0),
    ("Of those, ghosts of the other robot", "ghost_cells_{}", 1.0, "", 0),
    ("Range of the sighting", "range_m", 1.0, "m", 2),
    ("Time of the sighting", "t_s", 1.0, "s", 0),
)


def _columns(name: str) -> list[str]:
    """The columns that a name of `_MEASURES` stands for."""
    return list(dict.fromkeys(name.format(robot) for robot in (0, 1)))


CARD_COLUMNS = (
    "seed",
    "plan_id",
    "plan_digest",
    "episode_id",
    "event_id",
    "pair_id",
    "visible_fraction",
    *(column for _, name, *_ in _MEASURES for column in _columns(name)),
)
"""Columns that the card is computed from."""


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
    """The card: Markdown with the YAML header that Hugging Face reads.

    Args:
        sightings: `CARD_COLUMNS` of all pairs, their `split`, and the `visibility` in their image, which is
            null where there is no image.
        poses: `POSE_COLUMNS` of all training images and their `split`, or None without training images.
        counts: the counts of `explore`.
        left_out: episodes that could not be run.
        poses_left_out: training images that could not be made.
        parameters: all that the rows depend on, by dotted key, `explore.robot.name` among them.
        unknown: stages whose parameters are unknown because their output is gone.
        versions: of the packages that the rows were made with.
        bytes_total: size of the Parquet files.
    """
    has_images = poses is not None or sightings["visibility"].null_count < sightings.num_rows
    seeds = sorted({s for t in (sightings, poses) if t is not None for s in t["seed"].unique().to_pylist()})
    counted = {"floor plans": "plan_digest", "episodes": "episode_id", "rendezvous": "event_id"}
    splits = split_table(sightings, {**{k: distinct(v) for k, v in counted.items()}, "pairs": len})
    episodes = markdown_table(
        ("counted", "number"), [(k.replace("_", " "), f"{v:,}") for k, v in counts.items()]
    )
    rows = [(f"`{key}`", f"`{json.dumps(value)}`") for key, value in parameters.items()]
    sections = [
        yaml_header(sightings, poses),
        _INTRODUCTION.format(robot=parameters["explore.robot.name"], split=splits_with_rows(sightings)[0])
        + ("```" if poses is None else _LOADED_POSES.format(split=splits_with_rows(poses)[0])),
        f"## Splits\n\n{splits}\n\nNo floor plan is in two splits: a plan's split is a "
        f"hash of its geometry. {bytes_total / 1e6:.1f} MB in all.",
        f"## Episodes\n\n{episodes}{left_out_list('Episodes', left_out)}",
        f"## Overlap\n\n![Histogram of the overlap](overlap.png)\n\n{overlap_table(sightings)}",
        f"## Quality\n\n{quality_table(sightings)}\n\n{QUALITY_NOTE}",
        views_section(sightings),
        *([] if poses is None else [poses_section(poses) + left_out_list("Images", poses_left_out)]),
        f"## Columns of `pairs`\n\n{COLUMNS_NOTE}\n\n{column_table(PAIRS)}",
        *([] if poses is None else [f"## Columns of `poses`\n\n{column_table(POSES)}"]),
        *([f"## Licences of the images\n\n{licence_note(parameters)}"] if has_images else []),
        f"## How it was made\n\n{_origin(seeds, versions, unknown)}",
        "<details><summary>All parameters</summary>\n\n"
        f"{markdown_table(('parameter', 'value'), rows)}\n\n</details>",
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

QUALITY_NOTE = """\
Columns are quantiles; errors are those at the sighting, both robots pooled. Walls agree where an occupied
cell of one map that lies in the known area of the other is within 0.10 m of an occupied cell there.
`T_m0_m1_local` is built from the SLAM poses at the meeting and is the label to learn; `T_m0_m1` comes from
the true starts and contains the drift of both maps."""

COLUMNS_NOTE = """\
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


def histogram(values: Array, edges: Array, *, title: str, mark: float, mark_label: str) -> Image:
    """Bars of how many values (N,) fall between neighbouring edges (B + 1,), and a marked value.

    Returns:
        (H, W, 3) uint8 RGB.
    """
    counts, _ = np.histogram(values, edges)
    canvas = Canvas(_CHART_WIDTH_PX, _CHART_HEIGHT_PX)
    canvas.text(title, _LEFT_PX, 40, size_px=25, bold=True)
    base_px, step_px = _CHART_HEIGHT_PX - _BOTTOM_PX, (_CHART_WIDTH_PX - 2 * _LEFT_PX) / len(counts)
    px_per_count = (base_px - _TOP_PX - 50) / max(int(counts.max()), 1)
    for i, count in enumerate(counts):
        left_px, right_px = _LEFT_PX + i * step_px + 2, _LEFT_PX + (i + 1) * step_px - 2
        top_px = base_px - count * px_per_count
        corners = [[left_px, base_px], [left_px, top_px], [right_px, top_px], [right_px, base_px]]
        canvas.polygon(np.array(corners), colour=BLUE)
        canvas.text(str(count), left_px, top_px - 8, size_px=17, colour=MUTED)
    for i, edge in enumerate(edges[::2]):
        canvas.text(f"{edge:.1f}", _LEFT_PX + 2 * i * step_px - 12, base_px + 28, size_px=18)
    canvas.polyline(
        np.array([[_LEFT_PX, base_px], [_CHART_WIDTH_PX - _LEFT_PX, base_px]]), colour=INK, width_px=2
    )
    mark_px = _LEFT_PX + (mark - edges[0]) / (edges[-1] - edges[0]) * (_CHART_WIDTH_PX - 2 * _LEFT_PX)
    canvas.dashes(np.array([[mark_px, _TOP_PX], [mark_px, base_px]]), colour=RED, width_px=2)
    canvas.text(mark_label, mark_px + 8, _TOP_PX + 14, size_px=18, colour=RED)
    return canvas.image


def quality_table(sightings: pa.Table) -> str:
    """Quantiles of all measures, both robots pooled."""
    return quantile_table(
        [
            (f"{title} [{unit}]" if unit else title, factor * _pooled(sightings, name), decimals)
            for title, name, factor, unit, decimals in _MEASURES
        ]
    )


def _pooled(sightings: pa.Table, name: str) -> Array:
    columns = [sightings[column].drop_null().to_numpy() for column in _columns(name)]
    return np.concatenate(columns).astype(np.float64)


def yaml_header(sightings: pa.Table, poses: pa.Table | None) -> str:
    """What Hugging Face reads: tags, size, and the files of each table's splits."""
    rows, configs = sightings.num_rows, _yaml_config("pairs", sightings, default=True)
    if poses is not None:
        rows, configs = rows + poses.num_rows, configs + _yaml_config("poses", poses)
    tags = ("robotics", "slam", "map-fusion", "occupancy-grid", "multi-robot", "pose-estimation")
    sizes = [(10**3, "n<1K"), (10**4, "1K<n<10K"), (10**5, "10K<n<100K"), (10**6, "100K<n<1M")]
    size = next((name for bound, name in sizes if rows < bound), "1M<n<10M")
    tag_lines = "".join(f"- {tag}\n" for tag in tags)
    return (
        f"---\npretty_name: Rendezvous\ntags:\n{tag_lines}size_categories:\n- {size}\nconfigs:\n{configs}---"
    )


def _yaml_config(name: str, rows: pa.Table, *, default: bool = False) -> str:
    files = [f"  - split: {s}\n    path: {name}/{s}-*.parquet\n" for s in splits_with_rows(rows)]
    first = "  default: true\n" if default else ""
    return f"- config_name: {name}\n{first}  data_files:\n{''.join(files)}"


def splits_with_rows(rows: pa.Table) -> list[str]:
    """The splits that have rows."""
    present = set(rows["split"].unique().to_pylist())
    return [split for split in SPLITS if split in present]


def left_out_list(title: str, left_out: Sequence[Quarantined]) -> str:
    """How many are left out, with some of the reasons, or '' if none is."""
    if not left_out:
        return ""
    shown = list({entry.reason: entry for entry in left_out}.values())[:_REASONS_SHOWN]
    reasons = "\n".join(f"- `{entry.item_id}`: {entry.reason}" for entry in shown)
    return f"\n\n{title} left out, because they could not be made: {len(left_out)}. Reasons:\n\n{reasons}"


def overlap_table(sightings: pa.Table) -> str:
    """How many pairs overlap by how much."""
    overlap = sightings["overlap"].to_numpy()
    numbers, _ = np.histogram(overlap, _OVERLAP_EDGES)
    rows = [
        (f"{low:.2f} – {high:.2f}", number, f"{number / len(overlap):.1%}")
        for low, high, number in zip(_OVERLAP_EDGES[:-1], _OVERLAP_EDGES[1:], numbers, strict=True)
        if number
    ]
    table = markdown_table(("overlap", "pairs", "share"), rows)
    return f"{table}\n\n{np.mean(overlap < 0.25):.1%} of the pairs overlap by less than 0.25."


def _origin(seeds: Sequence[int], versions: Mapping[str, str], unknown: Sequence[str]) -> str:
    """What makes the same rows again. Several seeds mean that a stage was run again with another."""
    packages = ", ".join(f"{name} {version}" for name, version in versions.items())
    gone = ", ".join(f"`{stage}`" for stage in unknown)
    missing = f"\n\nNot known, because its output was gone: the parameters of {gone}." if unknown else ""
    seed = ", ".join(map(str, seeds))
    return f"Root seed {seed}, schema version {SCHEMA_VERSION}, {packages}.\n\n{_ORIGIN_NOTE}{missing}"
