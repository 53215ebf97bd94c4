"""Take the picture of every sighting, and training images of the robot, with DOPE's labels."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from functools import partial
from typing import Any

from rendezvous.config.sections import RenderSection
from rendezvous.engine.run import Run, Task, part_name
from rendezvous.errors import ConfigError, StoreError
from rendezvous.rendering.cycles.blender import check_blender, cycles_name
from rendezvous.rendering.opengl.gl import check_libraries, renderer_name
from rendezvous.rendering.robot_model import check_inside_cuboid, robot_parts
from rendezvous.robot_file import load_robot, load_robot_model
from rendezvous.schema import POSES, VIEWS
from rendezvous.simulation.robot import RobotSpec
from rendezvous.stages.dataset.item_tasks import item_tasks
from rendezvous.stages.dataset.photos import photo_folder
from rendezvous.stages.dataset.pictures import RenderJob, poses, views
from rendezvous.store.read import StageReader, chunks
from rendezvous.store.records import Inputs, Manifest
from rendezvous.store.tables import Layout, column_types

VERSION = 4
LAYOUT = Layout(item_column="plan_id", uncompressed=("image",), row_group_rows=256)


def render(run: Run) -> Manifest:
    """Write a picture of each sighting, and the training images.

    Raises:
        ConfigError: `explore` ran with another robot, the robot has no model, or there are no photos.
        SetupError: rendering does not work on this machine, or Blender is wanted and not installed; and there
            is something to render.
    """
    section, robot = run.config.render, run.config.explore.robot
    meshes, explore = run.read("meshes"), run.read("explore")
    spec, model = load_robot(robot), load_robot_model(robot)
    check_inside_cuboid(robot_parts(model, source=f"model of {robot}"), spec.cuboid, robot=spec.name)
    _check_same_robot(explore, spec)
    photos = photo_folder(section.backgrounds)
    job = RenderJob(seed=run.config.seed, robot=robot, section=section, photos=photos)
    shared = {"render.robot": spec.parameters(), "render.robot.model": hashlib.sha256(model).hexdigest()}
    tasks = [
        *(_view_tasks(job, meshes, explore, shared) if section.views else ()),
        *(_pose_tasks(job, meshes, shared) if section.poses_per_plan else ()),
    ]
    return run.build(
        "render",
        tasks,
        layout=LAYOUT,
        total=len(tasks),
        prepare=lambda: run.say(
            f"render: drawing with {cycles_name() if section.engine == 'cycles' else renderer_name()}"
        ),
    )


def check_pictures(run: Run) -> None:
    """Check early that `render` has what it needs, if it has anything to do.

    Raises:
        ConfigError: the robot has no model, or there are no photos.
        SetupError: a system library is missing, or Blender is wanted and not installed.
    """
    section = run.config.render
    if section.views or section.poses_per_plan:
        check_libraries()
        if section.engine == "cycles":
            check_blender()
        load_robot_model(run.config.explore.robot)
        photo_folder(section.backgrounds)


def _check_same_robot(explore: StageReader, robot: RobotSpec) -> None:
    wanted = Inputs(parameters={"explore.robot": robot.parameters()}, items={}).parameters
    for shard in explore.shards():
        used = shard.inputs.parameters
        differing = [key for key, value in wanted.items() if used.get(key) != value]
        if differing:
            key = differing[0]
            raise ConfigError(
                f"{explore.root}/{shard.name} was made with {key} {used.get(key)!r}, "
                f"now it is {wanted[key]!r}; run `rendezvous explore` with this robot first"
            )


def _view_tasks(
    job: RenderJob, meshes: StageReader, explore: StageReader, shared: dict[str, Any]
) -> Iterator[Task]:
    plans = {item.item_id: item for item in meshes.items()}
    section = job.section
    parameters = {
        *("render.engine", "render.cycles_samples"),
        *("render.draws.shadow_share", "render.jpeg_quality", "render.texture_variants"),
    }
    drawn = {
        k: v
        for k, v in section.parameters(exclude=_unused(section)).items()
        if k in parameters or k.startswith("render.draws.robot.")
    }
    for index, batch in enumerate(chunks(explore.items(), section.plans_per_shard)):
        if gone := [item.item_id for item in batch if item.item_id not in plans]:
            raise StoreError(
                f"{meshes.root}: no plan {gone[0]!r}, on which {explore.root} has sightings; "
                "run `rendezvous explore` again"
            )
        walls = tuple(plans[item.item_id] for item in batch)
        yield Task(
            name=f"views/{part_name(index)}",
            inputs=Inputs(
                parameters=drawn | shared,
                columns=column_types(VIEWS.arrow()),
                items={item.item_id: item.digest for item in batch}
                | {f"{item.item_id} (meshes)": item.digest for item in walls},
                seed=job.seed,
                version=VERSION,
            ),
            make=partial(views, job, meshes, walls, explore, batch),
        )


def _pose_tasks(job: RenderJob, meshes: StageReader, shared: dict[str, Any]) -> Iterator[Task]:
    section = job.section
    photos = {"render.backgrounds": job.photos.digest() if job.photos else None}
    return item_tasks(
        chunks(meshes.items(), section.plans_per_shard),
        partial(poses, job, meshes),
        table=POSES,
        parameters=section.parameters(exclude={"plans_per_shard", "views", "backgrounds", *_unused(section)})
        | shared
        | photos,
        seed=job.seed,
        version=VERSION,
        under="poses/",
    )


def _unused(section: RenderSection) -> tuple[str, ...]:
    """Parameters that only the other engine reads."""
    return () if section.engine == "cycles" else ("cycles_samples",)
