"""A dataset of synthetic sightings: `explore`'s output, made in a moment."""

from __future__ import annotations

import io
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console

from pipeline.config import load_config
from pipeline.engine import Run, Task, part_name
from pipeline.pool import Engine
from pipeline.schema import EXPLORE
from pipeline.stages.pack import LAYOUT
from pipeline.store.records import Inputs, Shard
from tests.synthetic import synthetic_row

STAGES_YAML = Path(__file__).parents[1] / "stages.yaml"
SHARES = ("pack.validation_fraction=0.3", "pack.test_fraction=0.3", "pack.rows_per_file=4")
PARAMETERS = {"explore.max_range_m": 4.0, "explore.robot": {"name": "scout", "radius_m": 0.2}}
PLANS = 10
ROWS = [
    [synthetic_row(np.random.default_rng([plan, event]), plan=plan, event=event) for event in range(2)]
    for plan in range(PLANS)
]


def synthetic_run(data: Path, *overrides: str) -> Run:
    """A run whose split shares suit ten plans, in this process."""
    config = load_config(STAGES_YAML, preset="smoke", overrides=[*SHARES, *overrides])
    return Run(
        config=config, data=str(data), workers=1, engine=Engine.INLINE, console=Console(file=io.StringIO())
    )


def shard_of(rows: list[dict[str, Any]]) -> Shard:
    """What `explore` would have made of these sightings."""
    return Shard(table=EXPLORE.table(rows), counts={"episodes": 3, "episodes_without_meeting": 1})


def explored(data: Path, *, plans: int = PLANS, turn: int = 0) -> None:
    """Stands in for `explore`: a shard for every two plans; `turn` rotates the plans' order."""
    order = np.roll(np.arange(plans), turn).reshape(-1, 2).tolist()
    tasks = [
        Task(
            name=part_name(number),
            inputs=Inputs(parameters=PARAMETERS, items={str(p): "" for p in shard}, seed=0),
            make=partial(shard_of, [row for plan in shard for row in ROWS[plan]]),
        )
        for number, shard in enumerate(order)
    ]
    synthetic_run(data).build("explore", tasks, layout=LAYOUT)
