"""Drive two robots through each plan until they meet; write one row per sighting."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from functools import partial
from typing import Any

import numpy as np

from rendezvous.config.sections import ExploreSection
from rendezvous.engine.run import Run
from rendezvous.errors import ConfigError, FloorplanError
from rendezvous.exploration.episode import Surroundings, furnished, in_the_way, run_episode
from rendezvous.exploration.records import Episode
from rendezvous.exploration.starts import draw_starts
from rendezvous.floorplan.furnish import furnish
from rendezvous.floorplan.records import Floorplan, Solid
from rendezvous.floorplan.validate import start_regions
from rendezvous.geometry.se2 import SE2, Array
from rendezvous.plan_schema import PLAN_COLUMNS, plan_of, solid_rows, solids_of
from rendezvous.robot_file import load_lidar, load_robot
from rendezvous.schema import EXPLORE
from rendezvous.seeds import stream
from rendezvous.simulation.robot import Lidar, RobotSpec
from rendezvous.stages.dataset.episode_draws import (
    changed_after,
    draw_change,
    draw_lidars,
    in_words,
    lidar_label,
)
from rendezvous.stages.dataset.item_tasks import item_tasks
from rendezvous.stages.dataset.sightings import EpisodeScene, sighting_rows
from rendezvous.store.read import Item, StageReader, chunks
from rendezvous.store.records import Manifest, Quarantined, Shard
from rendezvous.store.tables import Layout

VERSION = 1
LAYOUT = Layout(item_column="plan_id", uncompressed=("map_0", "map_1", "image"), row_group_rows=256)


def explore(run: Run) -> Manifest:
    """Write the sightings of every plan's episodes.

    Raises:
        FloorplanError: no episode could be run.
    """
    section, seed = run.config.explore, run.config.seed
    robot = load_robot(section.robot)
    lidars = {name: _fitting_lidar(name, robot) for name in section.lidar}
    meshes = run.read("meshes")
    batches = list(chunks(meshes.items(), section.plans_per_shard))
    tasks = item_tasks(
        batches,
        partial(explored_plans, meshes, section, robot, lidars, seed),
        table=EXPLORE,
        parameters=_parameters(section, robot, lidars),
        seed=seed,
        version=VERSION,
    )
    manifest = run.build("explore", tasks, layout=LAYOUT, total=len(batches))
    _report_left_out(run, manifest)
    return manifest


def _fitting_lidar(name: str, robot: RobotSpec) -> Lidar:
    lidar = load_lidar(name)
    try:
        robot.with_lidar(lidar)
    except ConfigError as error:
        raise ConfigError(f"explore.lidar: {name}: {error}") from error
    return lidar


def _parameters(section: ExploreSection, robot: RobotSpec, lidars: Mapping[str, Lidar]) -> dict[str, Any]:
    """What a shard depends on; nothing more than before there was a choice where none is made."""
    left_out = {"plans_per_shard", "robot", "lidar"}
    if section.changed_share == 0.0:
        left_out |= {"changed_share", "changed_furniture"}
    drawn = {
        f"explore.lidar.{lidar_label(name)}": {"weight": section.lidar[name], **asdict(lidar)}
        for name, lidar in lidars.items()
    }
    return section.parameters(exclude=left_out) | {"explore.robot": robot.parameters()} | drawn


def _report_left_out(run: Run, manifest: Manifest) -> None:
    left_out = manifest.quarantined
    if not left_out:
        return
    line = f"{len(left_out)} episodes left out, the first: {left_out[0].item_id}: {left_out[0].reason}"
    if not manifest.counts()["episodes"]:
        raise FloorplanError(f"explore: {line}; no episode could be run")
    run.say(f"explore: {line}")


def explored_plans(
    meshes: StageReader,
    section: ExploreSection,
    robot: RobotSpec,
    lidars: Mapping[str, Lidar],
    seed: int,
    items: Sequence[Item],
) -> Shard:
    """The sightings of some plans' episodes; an episode that cannot be run is quarantined."""
    rows: list[dict[str, Any]] = []
    counts: Counter[str] = Counter(
        episodes=0, episodes_left_out=0, episodes_without_meeting=0, events=0, pairs=0, simulated_s=0
    )
    quarantined = []
    for row in meshes.rows(items, columns=[*PLAN_COLUMNS, "walls"]):
        plan, walls = plan_of(row), solids_of(row["walls"])
        for number in range(section.episodes_per_plan):
            episode_id = f"{plan.plan_id}-e{number:03d}"
            try:
                scene, episode = _run(plan, walls, section, robot, lidars, seed, number)
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


def _run(
    plan: Floorplan,
    walls: Sequence[Solid],
    section: ExploreSection,
    robot: RobotSpec,
    lidars: Mapping[str, Lidar],
    seed: int,
    number: int,
) -> tuple[EpisodeScene, Episode]:
    """Furnish the plan, place the robots and let them explore; each step draws from its own stream."""
    key = ("explore", plan.plan_id, number)
    furniture = furnish(
        plan,
        stream(seed, *key, "furniture"),
        density=section.furniture_density,
        robot_radius_m=robot.radius_m,
    )
    carried = draw_lidars(section.lidar, rng=stream(seed, *key, "lidars"))
    first, second = (robot if name is None else robot.with_lidar(lidars[name]) for name in carried)
    changed = draw_change(section, rng=stream(seed, *key, "changed"))
    surroundings = furnished(plan, walls, furniture, robot)
    worlds, furnitures = (surroundings, surroundings), (furniture, furniture)
    if changed is not None:
        furnitures = (furniture, changed_after(plan, section, robot, seed, key, changed))
        worlds = (surroundings, furnished(plan, walls, furnitures[1], robot))
    # Clear of what either of them finds.
    everything = tuple(dict.fromkeys(furnitures[0] + furnitures[1]))
    starts = _starts(plan, section, robot, everything, surroundings, stream(seed, *key, "starts"))
    episode = run_episode(worlds, (first, second), starts, section.episode, rng=stream(seed, *key, "episode"))
    scene = EpisodeScene(
        plan=plan,
        furniture=(solid_rows(furnitures[0]), solid_rows(furnitures[1])),
        density=section.furniture_density,
        lidar_segments_m=(_seen(worlds[0]), _seen(worlds[1])),
        starts=starts,
        robot=robot,
        drive=str(section.episode.drive),
        drawn=in_words(carried, changed),
    )
    return scene, episode


def _starts(
    plan: Floorplan,
    section: ExploreSection,
    robot: RobotSpec,
    furniture: Sequence[Solid],
    surroundings: Surroundings,
    rng: np.random.Generator,
) -> tuple[SE2, SE2]:
    return draw_starts(
        plan,
        start_regions(plan, robot_radius_m=robot.radius_m),
        in_the_way(furniture, robot),
        surroundings.lidar_scene,
        clearance_m=robot.radius_m + section.start_margin_m,
        passage_m=robot.radius_m + section.episode.explorer.hard_margin_m,
        least_distance_m=section.start_distance_m,
        rng=rng,
    )


def _seen(surroundings: Surroundings) -> Array:
    return _outline(surroundings.lidar_scene.segments_m, surroundings.lidar_scene.circles_m)


def _outline(segments_m: Array, circles_m: Array) -> Array:
    """(E, 4) [m] segments of everything the lidar sees; a cylinder becomes an octagon."""
    turns = np.linspace(0.0, 2.0 * np.pi, 9)
    ring = np.stack([np.cos(turns), np.sin(turns)], axis=1)
    corners_m = circles_m[:, None, :2] + circles_m[:, None, 2:] * ring
    sides_m = np.concatenate([corners_m[:, :-1], corners_m[:, 1:]], axis=2).reshape(-1, 4)
    return np.concatenate([segments_m, sides_m])
