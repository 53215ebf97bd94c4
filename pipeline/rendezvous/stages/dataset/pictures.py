"""Rows of images with labels: what the observer saw at each sighting, and training images."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import groupby
from operator import itemgetter
from typing import Any

import cv2
import numpy as np

from rendezvous.config.sections import RenderSection
from rendezvous.errors import FloorplanError
from rendezvous.floorplan.furnish import furnish
from rendezvous.floorplan.records import Floorplan
from rendezvous.geometry.camera import Image, se3_from_se2
from rendezvous.geometry.se2 import SE2
from rendezvous.plan_schema import PLAN_COLUMNS, plan_of, solids_of
from rendezvous.rendering.free_scenes import draw_free
from rendezvous.rendering.plan_scene import RoomLooks, draw_room_looks
from rendezvous.rendering.randomise import Drawn, draw_plausible, room_scene
from rendezvous.rendering.robot_family import Variant
from rendezvous.rendering.robot_model import robot_parts
from rendezvous.rendering.studio import Studio
from rendezvous.rendering.viewpoints import FurnishedPlan, furnished_plan
from rendezvous.robot_file import load_robot, load_robot_model
from rendezvous.schema import POSES, VIEWS
from rendezvous.seeds import stream
from rendezvous.stages.dataset.photos import PhotoFolder
from rendezvous.store.read import Item, StageReader
from rendezvous.store.records import Quarantined, Shard

_WALLS = (*PLAN_COLUMNS, "wall_height_m")
_TRUE_POSES = ("T_w_m0", "T_w_m1", "T_m0_r0_true", "T_m1_r1_true")
_SIGHTING = ("pair_id", "plan_id", "episode_id", *_TRUE_POSES, "furniture")


@dataclass(frozen=True, slots=True, kw_only=True)
class RenderJob:
    """What all images of a run share; small to pickle."""

    seed: int
    robot: str
    section: RenderSection
    photos: PhotoFolder

    def studio(self) -> Studio:
        return _studio(
            self.seed, self.robot, self.section.texture_variants, self.section.cycles_samples_if_used
        )


@lru_cache(maxsize=1)
def _studio(seed: int, robot: str, variants: int, cycles_samples: int | None) -> Studio:
    parts = robot_parts(load_robot_model(robot), source=f"model of {robot}")
    return Studio(
        stream(seed, "render", "textures"),
        load_robot(robot),
        parts,
        variants=variants,
        cycles_samples=cycles_samples,
    )


def views(
    job: RenderJob, meshes: StageReader, walls: Sequence[Item], explore: StageReader, items: Sequence[Item]
) -> Shard:
    """The view of the observer's camera at each sighting on some plans."""
    plans = {row["plan_id"]: row for row in meshes.rows(walls, columns=_WALLS)}
    rows = []
    sightings = explore.rows(items, columns=_SIGHTING)
    for (plan_id, episode_id), group in groupby(sightings, key=itemgetter("plan_id", "episode_id")):
        furniture: Any = None
        for sighting in group:
            # The other robot's world may be another one.
            if sighting["furniture"] != furniture:
                furniture = sighting["furniture"]
                rooms = _rooms(job, plans[plan_id], furniture, episode_id)
            view = _image_row(job, _drawn_view(job, rooms, sighting), {})
            rows.append({"pair_id": sighting["pair_id"], "plan_id": plan_id} | view)
    counts = {"views": len(rows), "views_half_visible": sum(row["visibility"] >= 0.5 for row in rows)}
    return Shard(table=VIEWS.table(rows), counts=counts)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Rooms:
    """An episode's furnished plan, and how it and the robot seen look in all of the episode's images."""

    place: FurnishedPlan
    looks: RoomLooks
    robot: Variant


def _rooms(
    job: RenderJob, walls: Mapping[str, Any], furniture: Sequence[Mapping[str, Any]], episode_id: str
) -> _Rooms:
    place = furnished_plan(plan_of(walls), solids_of(furniture), wall_height_m=walls["wall_height_m"])
    rng = stream(job.seed, "render", "episode", episode_id)
    looks = draw_room_looks(rng, place, variants=job.section.texture_variants)
    variants = job.section.texture_variants
    robot = job.studio().looks.draw(rng, job.section.draws.robot, wear=1.0, variants=variants)
    return _Rooms(place=place, looks=looks, robot=robot)


def _drawn_view(job: RenderJob, rooms: _Rooms, sighting: Mapping[str, Any]) -> Drawn:
    """The scene of a sighting, with both robots at their true poses."""
    studio = job.studio()
    T_w_r0, T_w_r1 = (
        SE2.from_array(sighting[f"T_w_m{i}"]) @ SE2.from_array(sighting[f"T_m{i}_r{i}_true"]) for i in (0, 1)
    )
    return room_scene(
        stream(job.seed, "render", "view", sighting["pair_id"]),
        rooms.place,
        rooms.looks,
        rooms.robot,
        studio.camera,
        job.section.draws,
        T_w_c=se3_from_se2(T_w_r0) @ studio.robot.camera.T_r_c(),
        T_w_r1=T_w_r1,
    )


def poses(job: RenderJob, meshes: StageReader, items: Sequence[Item]) -> Shard:
    """Training images in some plans; one without room for its robots is quarantined."""
    rows: list[dict[str, Any]] = []
    quarantined = []
    for walls in meshes.rows(items, columns=_WALLS):
        for number, place in _furnished(job, plan_of(walls), walls["wall_height_m"]):
            pose_id = f"{place.plan.plan_id}-p{number:04d}"
            try:
                rows.append(_pose_row(job, place, pose_id, number))
            except FloorplanError as error:
                quarantined.append(Quarantined(item_id=pose_id, reason=str(error)))
    counts = {
        "poses": len(rows),
        "poses_plausible": sum(row["mode"] == "plausible" for row in rows),
        "poses_without_robot": sum(row["T_c_o"] is None for row in rows),
        "poses_left_out": len(quarantined),
    }
    return Shard(table=POSES.table(rows), counts=counts, quarantined=tuple(quarantined))


def _furnished(job: RenderJob, plan: Floorplan, wall_height_m: float) -> Iterator[tuple[int, FurnishedPlan]]:
    """The number of each of a plan's images, and the plan furnished for that image."""
    section = job.section
    numbers = range(section.poses_per_plan)
    for furnishing, group in groupby(numbers, key=lambda number: number // section.poses_per_furnishing):
        rng = stream(job.seed, "render", "furniture", plan.plan_id, furnishing)
        furniture = furnish(
            plan, rng, density=section.furniture_density, robot_radius_m=job.studio().robot.radius_m
        )
        place = furnished_plan(plan, furniture, wall_height_m=wall_height_m)
        for number in group:
            yield number, place


def _pose_row(job: RenderJob, place: FurnishedPlan, pose_id: str, number: int) -> dict[str, Any]:
    studio, plan = job.studio(), place.plan
    robot = studio.robot
    mode = _mode(job, plan.plan_id, number)
    drawn = _drawn_pose(job, place, mode, stream(job.seed, "render", "pose", plan.plan_id, number))
    camera = drawn.scene.camera
    furnishing = number // job.section.poses_per_furnishing if mode == "plausible" else None
    return {
        "pose_id": pose_id,
        "plan_id": plan.plan_id,
        "plan_digest": plan.digest(),
        "seed": job.seed,
        "mode": mode,
        "image_width_px": camera.width_px,
        "image_height_px": camera.height_px,
        "K": camera.K(),
        "T_r0_c": None if drawn.T_r0_c is None else robot.camera.T_r_c(),
        "T_r0_c_true": drawn.T_r0_c,
        "robot": robot.name,
        "cuboid_size_m": robot.cuboid.size_m,
        "T_r1_o": robot.cuboid.T_r_o(),
        **_image_row(job, drawn, {"furnishing": furnishing}),
    }


def _drawn_pose(job: RenderJob, place: FurnishedPlan, mode: str, rng: np.random.Generator) -> Drawn:
    studio, section = job.studio(), job.section
    variants = section.texture_variants
    if mode == "plausible":
        return draw_plausible(rng, place, studio.looks, studio.robot, section.draws, variants=variants)
    return draw_free(
        rng, studio.looks, studio.camera, studio.textures, section.draws, variants=variants, photos=job.photos
    )


def _mode(job: RenderJob, plan_id: str, number: int) -> str:
    """`plausible` for the given share of images, evenly spread; each plan draws its offset (uniform)."""
    share = job.section.draws.plausible_share
    begin = float(stream(job.seed, "render", "modes", plan_id).random())
    crosses = math.floor((number + 1) * share + begin) > math.floor(number * share + begin)
    return "plausible" if crosses else "free"


def _image_row(job: RenderJob, drawn: Drawn, more: Mapping[str, Any]) -> dict[str, Any]:
    """The columns of an image and its label; `more` is added to `drawn`."""
    studio = job.studio()
    picture = studio.take(drawn)
    view = picture.view
    record = {**drawn.record, **more, "engine": job.section.engine, "renderer": studio.renderer}
    return {
        "image": _encoded(picture.rgb, job.section.jpeg_quality),
        "drawn": json.dumps(record, separators=(",", ":")),
        "T_c_o": picture.T_c_o,
        "projected_cuboid_px": picture.projected_cuboid_px,
        "visibility": view.visibility,
        "visible_px": view.visible_px,
        "silhouette_px": view.silhouette_px,
        "box_px": view.box_px,
    }


def _encoded(rgb: Image, jpeg_quality: int | None) -> bytes:
    """The image as JPEG without chroma subsampling, or as PNG if there is no quality."""
    bgr = cv2.cvtColor(rgb, cv2.COLOR_RGB2BGR)
    if jpeg_quality is None:
        return cv2.imencode(".png", bgr)[1].tobytes()
    options = [
        cv2.IMWRITE_JPEG_QUALITY, jpeg_quality,
        cv2.IMWRITE_JPEG_SAMPLING_FACTOR, cv2.IMWRITE_JPEG_SAMPLING_FACTOR_444,
    ]  # fmt: skip
    return cv2.imencode(".jpg", bgr, options)[1].tobytes()
