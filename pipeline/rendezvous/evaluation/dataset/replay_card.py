"""The card of a dataset made out of recorded logs."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import pyarrow as pa

from rendezvous.evaluation.dataset.card import (
    COLUMNS_NOTE,
    QUALITY_NOTE,
    left_out_list,
    overlap_table,
    quality_table,
    splits_with_rows,
    yaml_header,
)
from rendezvous.evaluation.dataset.tables import column_table, distinct, markdown_table, split_table
from rendezvous.schema import PAIRS, SCHEMA_VERSION
from rendezvous.store.records import Quarantined


@dataclass(frozen=True, slots=True, kw_only=True)
class LogEntry:
    """A log as the card lists it."""

    file: str
    building: str
    split: str
    sha256: str
    pairs: int


def replay_card(
    sightings: pa.Table,
    logs: Sequence[LogEntry],
    *,
    counts: Mapping[str, int],
    left_out: Sequence[Quarantined],
    parameters: Mapping[str, Any],
    versions: Mapping[str, str],
    bytes_total: int,
) -> str:
    """The card: Markdown with the YAML header that Hugging Face reads.

    Args:
        sightings: `CARD_COLUMNS` of all pairs, and their `split`.
        logs: all logs in order.
        counts: what was drawn and what came of it.
        left_out: logs without a pair.
        parameters: all that the rows depend on, by dotted key.
        versions: of the packages that the rows were made with.
        bytes_total: size of the Parquet files.
    """
    splits = split_table(sightings, {"buildings": distinct("plan_digest"), "pairs": len})
    listed = [(f"`{log.file}`", log.building, log.split, f"{log.pairs:,}", f"`{log.sha256}`") for log in logs]
    drawn = [(name.replace("_", " "), f"{count:,}") for name, count in counts.items()]
    rows = [(f"`{key}`", f"`{json.dumps(value)}`") for key, value in parameters.items()]
    seeds = ", ".join(str(seed) for seed in sorted(sightings["seed"].unique().to_pylist()))
    packages = ", ".join(f"{name} {version}" for name, version in versions.items())
    sections = [
        yaml_header(sightings, None),
        _INTRODUCTION.format(split=splits_with_rows(sightings)[0]),
        "## Logs\n\n"
        + markdown_table(("log", "building", "split", "pairs", "SHA-256"), listed)
        + left_out_list("Logs", left_out),
        f"## Splits\n\n{splits}\n\nNo building is in two splits. {bytes_total / 1e6:.1f} MB in all.",
        f"## Draws\n\n{markdown_table(('counted', 'number'), drawn)}",
        f"## Overlap\n\n![Histogram of the overlap](overlap.png)\n\n{overlap_table(sightings)}",
        f"## Quality\n\n{quality_table(sightings)}\n\n{QUALITY_NOTE}\n{_TRUTH_NOTE}",
        f"## Columns of `pairs`\n\n{COLUMNS_NOTE}\n\n{column_table(PAIRS)}",
        f"## How it was made\n\nRoot seed {seeds}, schema version {SCHEMA_VERSION}, {packages}.",
        "<details><summary>All parameters</summary>\n\n"
        f"{markdown_table(('parameter', 'value'), rows)}\n\n</details>",
    ]
    return "\n\n".join(sections) + "\n"


_INTRODUCTION = """# Rendezvous, recorded

Pairs of maps out of laser logs of real robots. Two stretches of one log become robot 0 and robot 1; each is
mapped by a SLAM of its own from scratch, forwards or backwards, and both end where the scans show that one
robot would have seen the other. The meeting is virtual: there was one robot, and no image (`image` and the
columns of its label are null); the camera in `T_r0_c` faces robot 1. The true poses are the log's reference,
or relations measured by hand.

![Three of the pairs: each robot's map, and both aligned](pairs.png)

```python
from datasets import load_dataset

pairs = load_dataset("path/to/this/folder", split="{split}")
```"""

_TRUTH_NOTE = """
All errors are against the log's reference, which is another SLAM's and errs by some centimetres itself. Where
a log has no odometry it is the reference's motion with drawn noise."""
