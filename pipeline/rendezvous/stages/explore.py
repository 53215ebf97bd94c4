"""Drive two robots through every plan until they meet; write one row per sighting."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from functools import partial
from typing import Any

import numpy as np

from rendezvous.config.sections import ExploreSection
from rendezvous.engine.run import Run, Task, part_name
from rendezvous.errors import FloorplanError
from rendezvous.exploration.episode import run_episode
from rendezvous.exploration.records import Episode
from rendezvous.exploration.starts import draw_starts
from rendezvous.exploration.surroundings import furnished, in_the_way
from rendezvous.floorplan.furnish import furnish
from rendezvous.floorplan.records import Floorplan, Solid
from rendezvous.floorplan.validate import start_regions
from rendezvous.geometry.se2 import Array
from rendezvous.plan_schema import PLAN_COLUMNS, plan_of, solid_rows, solids_of
from rendezvous.robot_file import load_robot
from rendezvous.schema import EXPLORE
from rendezvous.seeds import stream
from rendezvous.simulation.robot import RobotSpec
from rendezvous.stages.dataset.sightings import Scene, sighting_rows
from rendezvous.store.digest import column_types
from rendezvous.store.parquet import Layout
from rendezvous.store.read import Item, StageReader, chunks
from rendezvous.store.records import Inputs, Manifest, Quarantined, Shard

VERSION = 1
LAYOUT = Layout(item_column="plan_id", uncompressed=("map_0", "map_1", "image"), row_group_rows=256)


def explore(run: Run) -> Manifest:
    """Write the sightings of every plan's episodes."""
    section, seed = run.config.explore, run.config.seed
    robot = load_robot(section.robot)
    meshes = run.read("meshes")
    batches = list(chunks(meshes.items(), section.plans_per_shard))
    tasks = (
        Task(
            name=part_name(index),
            inputs=Inputs(
                parameters=section.parameters(exclude={"plans_per_shard", "robot"})
                | {"explore.robot": asdict(robot)},
                columns=column_types(EXPLORE.arrow()),
                items={item.item_id: item.digest for item in batch},
                seed=seed,
                version=VERSION,
            ),
            make=partial(explored_plans, meshes, batch, section, robot, seed),
        )
        for index, batch in enumerate(batches)
    )
    manifest = run.build("explore", tasks, layout=LAYOUT, total=len(batches))
    _report_left_out(run, manifest)
    return manifest


def _report_left_out(run: Run, manifest: Manifest) -> None:
    """Say how many episodes could not be run, and why the first could not.

    Raises:
        FloorplanError: none could.
    """
    left_out = [item for shard in manifest.shards for item in shard.quarantined]
    if not left_out:
        return
    line = f"{len(left_out)} episodes left out, the first: {left_out[0].item_id}: {left_out[0].reason}"
    if not manifest.counts()["episodes"]:
        raise FloorplanError(f"explore: {line}; no episode could be run")
    run.say(f"explore: {line}")


def explored_plans(
    meshes: StageReader, items: Sequence[Item], section: ExploreSection, robot: RobotSpec, seed: int
) -> Shard:
    """The sightings of some plans' episodes; an episode that cannot be run is left out with its reason."""
    rows: list[dict[str, Any]] = []
    counts: Counter[str] = Counter(
        episodes=0, episodes_left_out=0, episodes_without_meeting=0, events=0, pairs=0, simulated_s=0
    )
    quarantined = []
    for row in meshes.rows(items, columns=[*PLAN_COLUMNS, "walls"]):
        plan, walls = plan_of(row), solids_of(row["walls"])
        for episode_id, number in _episodes(plan, section):
            try:
                scene, episode = _run(plan, walls, section, robot, seed, number)
            except (FloorplanError, FloatingPointError) as error:
                counts["episodes_left_out"] += 1
                quarantined.append(Quarantined(item_id=episode_id, reason=str(error)))
                continue
            found = list(sighting_rows(scene, episode, episode_id=episode_id, seed=seed))
            rows += found
            counts["episodes"] += 1
            counts["episodes_without_meeting"] += not episode.events
            counts["events"] += len(episode.events)
            counts["pairs"] += len(found)
            counts["simulated_s"] += round(episode.simulated_s)
    return Shard(table=EXPLORE.table(rows), counts=counts, quarantined=tuple(quarantined))


def _episodes(plan: Floorplan, section: ExploreSection) -> Iterator[tuple[str, int]]:
    for number in range(section.episodes_per_plan):
        yield f"{plan.plan_id}-e{number:03d}", number


def _run(
    plan: Floorplan,
    walls: Sequence[Solid],
    section: ExploreSection,
    robot: RobotSpec,
    seed: int,
    number: int,
) -> tuple[Scene, Episode]:
    """Furnish the plan, place the robots and let them go; each draws from a stream of its own."""
    key = ("explore", plan.plan_id, number)
    furniture = furnish(
        plan,
        stream(seed, *key, "furniture"),
        density=section.furniture_density,
        robot_radius_m=robot.radius_m,
    )
    surroundings = furnished(plan, walls, furniture, robot)
    starts = draw_starts(
        plan,
        start_regions(plan, robot_radius_m=robot.radius_m),
        in_the_way(furniture, robot),
        surroundings.lidar_scene,
        clearance_m=robot.radius_m + section.start_margin_m,
        passage_m=robot.radius_m + section.episode.explorer.hard_margin_m,
        least_distance_m=section.start_distance_m,
        rng=stream(seed, *key, "starts"),
    )
    episode = run_episode(
        surroundings, (robot, robot), starts, section.episode, rng=stream(seed, *key, "episode")
    )
    scene = Scene(
        plan=plan,
        furniture=solid_rows(furniture),
        density=section.furniture_density,
        lidar_segments_m=_outline(surroundings.lidar_scene.segments_m, surroundings.lidar_scene.circles_m),
        starts=starts,
        robot=robot,
        drive=str(section.episode.drive),
    )
    return scene, episode


def _outline(segments_m: Array, circles_m: Array) -> Array:
    """(E, 4) [m]: all that the lidar sees as segments, a cylinder as an octagon."""
    turns = np.linspace(0.0, 2.0 * np.pi, 9)
    ring = np.stack([np.cos(turns), np.sin(turns)], axis=1)
    corners_m = circles_m[:, None, :2] + circles_m[:, None, 2:] * ring
    sides_m = np.concatenate([corners_m[:, :-1], corners_m[:, 1:]], axis=2).reshape(-1, 4)
    return np.concatenate([segments_m, sides_m])
