"""Raise walls and furniture from floor plans: boxes for physics and rays, GLB and MJCF for the rest."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

from pipeline.config import MeshesSection
from pipeline.engine import Run, Task, part_name
from pipeline.floorplan.furnish import furnish
from pipeline.floorplan.scene import floorplan_scene, glb
from pipeline.floorplan.walls import wall_boxes
from pipeline.plan_schema import MESHES, PLAN_COLUMNS, plan_of, plan_row, solid_rows
from pipeline.seeds import stream
from pipeline.store.parquet import Layout
from pipeline.store.read import Item, StageReader, chunks
from pipeline.store.records import Inputs, Manifest, Shard

VERSION = 1
LAYOUT = Layout(item_column="plan_id", identity=(*PLAN_COLUMNS, "wall_height_m", "walls"))


def meshes(run: Run) -> Manifest:
    """Write the solids and meshes of every floor plan."""
    section, seed = run.config.meshes, run.config.seed
    plans = run.read("floorplans")
    batches = list(chunks(plans.items(), section.plans_per_shard))
    tasks = (
        Task(
            name=part_name(index),
            inputs=Inputs(
                parameters=section.parameters(exclude={"plans_per_shard"}),
                items={item.item_id: item.digest for item in batch},
                seed=seed,
                version=VERSION,
            ),
            make=partial(raised_plans, plans, batch, section, seed),
        )
        for index, batch in enumerate(batches)
    )
    return run.build("meshes", tasks, layout=LAYOUT, total=len(batches))


def raised_plans(plans: StageReader, items: Sequence[Item], section: MeshesSection, seed: int) -> Shard:
    """Walls, furniture and meshes of some plans."""
    rows = []
    for row in plans.rows(items, columns=PLAN_COLUMNS):
        plan = plan_of(row)
        walls = wall_boxes(plan, height_m=section.wall_height_m)
        rng = stream(seed, "meshes", plan.plan_id)
        furniture = furnish(plan, rng, density=section.furniture_density)
        rows.append(
            {
                **plan_row(plan),
                "wall_height_m": section.wall_height_m,
                "walls": solid_rows(walls),
                "furniture": solid_rows(furniture),
                "glb": glb(floorplan_scene(plan, (), height_m=section.wall_height_m)),
                "glb_furnished": glb(floorplan_scene(plan, furniture, height_m=section.wall_height_m)),
            }
        )
    return Shard(table=MESHES.table(rows), counts={"plans": len(rows)})
