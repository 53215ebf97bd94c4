"""A dataset of synthetic sightings and images: the output of `explore` and `render`, made in a moment."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from rendezvous.engine.run import Run, Task, part_name
from rendezvous.schema import EXPLORE, POSES, VIEWS
from rendezvous.stages.pack import LAYOUT
from rendezvous.stages.render import LAYOUT as RENDER_LAYOUT
from rendezvous.store.read import chunks
from rendezvous.store.records import Inputs, Quarantined, Shard
from rendezvous.store.tables import column_types
from tests.conftest import run_in
from tests.synthetic import synthetic_pose, synthetic_row, synthetic_view

SHARES = ("pack.validation_fraction=0.3", "pack.test_fraction=0.3", "pack.rows_per_file=4")
PARAMETERS = {"explore.max_range_m": 4.0, "explore.robot": {"name": "scout", "radius_m": 0.2}}
PLANS, POSED_PLANS, POSES_PER_PLAN = 10, 12, 5
"""Floor plans on which robots met, those that have training images (some where nobody met), and how many."""
ROWS = [
    [synthetic_row(np.random.default_rng([plan, event]), plan=plan, event=event) for event in range(2)]
    for plan in range(PLANS)
]
VIEW_ROWS = [[synthetic_view(row) for row in rows] for rows in ROWS]
POSE_ROWS = [
    [synthetic_pose(plan=plan, number=number) for number in range(POSES_PER_PLAN)]
    for plan in range(POSED_PLANS)
]


def synthetic_run(data: Path, *overrides: str) -> Run:
    """A run whose split shares suit ten plans, in this process."""
    return run_in(str(data), [*SHARES, *overrides])


def shard_of(rows: list[dict[str, Any]]) -> Shard:
    """What `explore` would have made of these sightings."""
    return Shard(table=EXPLORE.table(rows), counts={"episodes": 3, "episodes_without_meeting": 1})


def explored(data: Path, *, plans: int = PLANS, turn: int = 0) -> None:
    """Stands in for `explore`: a shard for every two plans; `turn` rotates the plans' order.

    And for `render` after it, where nothing else is asked of it.
    """
    order = np.roll(np.arange(plans), turn).reshape(-1, 2).tolist()
    tasks = [
        task_of(
            part_name(number),
            shard_of([row for plan in shard for row in ROWS[plan]]),
            parameters=PARAMETERS,
            items={str(plan): "" for plan in shard},
        )
        for number, shard in enumerate(order)
    ]
    synthetic_run(data).build("explore", tasks, layout=LAYOUT)
    rendered(data)


def rendered(
    data: Path,
    *,
    views: bool = True,
    poses: Sequence[Sequence[dict[str, Any]]] = POSE_ROWS,
    redrawn: Collection[str] = (),
    parameters: Mapping[str, Any] = MappingProxyType({}),
    quarantined: tuple[Quarantined, ...] = (),
) -> None:
    """Stands in for `render`: a shard of images for each plan with sightings, one of poses for every three.

    Args:
        data: the folder of all stages.
        views: whether sightings have images.
        poses: training images of each plan.
        redrawn: plans whose images of sightings were made again, with something else drawn.
        parameters: of the stage, beside its robot.
        quarantined: training images that could not be made.
    """
    run, told = synthetic_run(data), {"render.robot": PARAMETERS["explore.robot"], **parameters}
    view_of = {row["pair_id"]: row for rows in VIEW_ROWS for row in rows}
    tasks = []
    for number, (item,) in enumerate(chunks(run.read("explore").items(), 1) if views else ()):
        drawn = {"drawn": '{"again": true}'} if item.item_id in redrawn else {}
        pairs = run.read("explore").rows([item], columns=["pair_id"])
        shard = Shard(table=VIEWS.table([view_of[pair["pair_id"]] | drawn for pair in pairs]))
        name, items = f"views/{part_name(number)}", {item.item_id: item.digest}
        tasks.append(task_of(name, shard, parameters=told | drawn, items=items))
    for number, plans in enumerate(poses[i : i + 3] for i in range(0, len(poses), 3)):
        rows = [row for plan in plans for row in plan]
        items = {row["plan_id"]: "" for row in rows}
        shard = Shard(table=POSES.table(rows), quarantined=quarantined if number == 0 else ())
        tasks.append(task_of(f"poses/{part_name(number)}", shard, parameters=told, items=items))
    run.build("render", tasks, layout=RENDER_LAYOUT)


def task_of(
    name: str, shard: Shard, *, parameters: Mapping[str, Any], items: Mapping[str, str], seed: int | None = 0
) -> Task:
    """A task whose shard is made already."""
    columns = column_types(shard.table.schema)
    inputs = Inputs(parameters=parameters, columns=columns, items=items, seed=seed)
    return Task(name=name, inputs=inputs, make=lambda: shard)


def explored_with_left_out(data: Path, rows: list[dict[str, Any]], reasons: Sequence[str]) -> None:
    """Stands in for an `explore` that could not run as many episodes as there are reasons."""
    left_out = tuple(Quarantined(item_id=f"plan-e{i:03d}", reason=reason) for i, reason in enumerate(reasons))
    shard = replace(shard_of(rows), quarantined=left_out)
    task = task_of(part_name(0), shard, parameters=PARAMETERS, items={})
    synthetic_run(data).build("explore", [task], layout=LAYOUT)
    rendered(data)
