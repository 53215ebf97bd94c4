"""Raise walls and furniture from floor plans: boxes for physics and rays, GLB and MJCF."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Any

from rendezvous.config.sections import MeshesSection
from rendezvous.engine.run import Run
from rendezvous.errors import FloorplanError
from rendezvous.exploration.starts import draw_starts
from rendezvous.floorplan.furnish import furnish
from rendezvous.floorplan.records import Floorplan
from rendezvous.floorplan.scene import floorplan_scene, glb
from rendezvous.floorplan.validate import start_regions
from rendezvous.floorplan.walls import lidar_outline, wall_boxes
from rendezvous.plan_schema import MESHES, PLAN_COLUMNS, plan_of, plan_row, solid_rows
from rendezvous.robot_file import load_robot
from rendezvous.seeds import stream
from rendezvous.simulation.rays import ray_scene
from rendezvous.simulation.robot import RobotSpec
from rendezvous.simulation.world import scene_mjcf
from rendezvous.stages.dataset.item_tasks import item_tasks
from rendezvous.store.read import Item, StageReader, chunks
from rendezvous.store.records import Manifest, Quarantined, Shard
from rendezvous.store.tables import Layout

VERSION = 1
LAYOUT = Layout(item_column="plan_id", identity=(*PLAN_COLUMNS, "wall_height_m", "walls"))


def meshes(run: Run) -> Manifest:
    """Write the solids and meshes of every floor plan."""
    section, seed = run.config.meshes, run.config.seed
    robot = load_robot(section.robot)
    plans = run.read("floorplans")
    batches = list(chunks(plans.items(), section.plans_per_shard))
    tasks = item_tasks(
        batches,
        partial(raised_plans, plans, section, robot, seed),
        table=MESHES,
        parameters=section.parameters(exclude={"plans_per_shard", "robot"})
        | {"meshes.robot": robot.parameters()},
        seed=seed,
        version=VERSION,
    )
    return run.build("meshes", tasks, layout=LAYOUT, total=len(batches))


def raised_plans(
    plans: StageReader, section: MeshesSection, robot: RobotSpec, seed: int, items: Sequence[Item]
) -> Shard:
    """Walls, furniture and meshes of some plans; one in which no two robots fit is quarantined."""
    rows, quarantined = [], []
    for row in plans.rows(items, columns=PLAN_COLUMNS):
        plan = plan_of(row)
        try:
            rows.append(_raised(plan, section, robot, seed))
        except FloorplanError as error:
            quarantined.append(Quarantined(item_id=plan.plan_id, reason=str(error)))
    return Shard(table=MESHES.table(rows), counts={"plans": len(rows)}, quarantined=tuple(quarantined))


def _raised(plan: Floorplan, section: MeshesSection, robot: RobotSpec, seed: int) -> dict[str, Any]:
    rng = stream(seed, "meshes", plan.plan_id)
    height_m = section.wall_height_m
    walls = wall_boxes(plan, height_m=height_m)
    furniture = furnish(plan, rng, density=section.furniture_density, robot_radius_m=robot.radius_m)
    starts = draw_starts(
        plan,
        start_regions(plan, robot_radius_m=robot.radius_m),
        furniture,
        ray_scene(*lidar_outline(plan, furniture, height_m=robot.lidar.z_m)),
        clearance_m=robot.radius_m,
        passage_m=robot.radius_m,
        least_distance_m=2.0 * robot.radius_m,
        rng=rng,
    )
    return {
        **plan_row(plan),
        "wall_height_m": height_m,
        "walls": solid_rows(walls),
        "furniture": solid_rows(furniture),
        "glb": glb(floorplan_scene(plan, (), height_m=height_m)),
        "glb_furnished": glb(floorplan_scene(plan, furniture, height_m=height_m)),
        "mjcf": scene_mjcf([*walls, *furniture], [robot, robot], starts),
    }
