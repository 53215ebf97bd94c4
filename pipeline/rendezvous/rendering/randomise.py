"""Random scenes of the robot in furnished rooms; `free_scenes` draws those that need not be plausible.

`draw_plausible` draws a scene for training, `room_scene` the view of a robot whose pose is known. All
randomness comes from the rng, and everything drawn is in the record.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import shapely

from rendezvous.geometry.camera import Image, PinholeCamera, camera_pose, se3_from_se2
from rendezvous.geometry.se2 import SE2, Array
from rendezvous.rendering.appearance.lighting import Lighting, room_lighting
from rendezvous.rendering.distractors import draw_thing, place_on_floor
from rendezvous.rendering.draws import PoseDraws
from rendezvous.rendering.effects import CameraEffects, draw_effects
from rendezvous.rendering.plan_scene import RoomLooks, draw_room_looks, room_instances
from rendezvous.rendering.record import JsonValue, plain
from rendezvous.rendering.robot_family import ROBOT, RobotLooks, Variant
from rendezvous.rendering.scene import Instance, Scene
from rendezvous.rendering.thing import Thing
from rendezvous.rendering.viewpoints import FurnishedPlan, RobotPoses, draw_robot_poses
from rendezvous.simulation.robot import Cuboid, RobotSpec

VIEW_M = 4.5  # small things farther away than this are not drawn


@dataclass(frozen=True, slots=True, kw_only=True)
class PlacedThing:
    """A small thing and its pose (4, 4) in w."""

    thing: Thing
    T_w_t: Array


@dataclass(frozen=True, slots=True, kw_only=True)
class Drawn:
    """A scene to take a picture of."""

    scene: Scene
    effects: CameraEffects  # the camera's effects on the picture
    T_w_r1: Array | None  # (4, 4) pose of the labelled robot; None if it is absent
    record: Mapping[str, JsonValue]  # everything that was drawn, as plain JSON
    T_r0_c: Array | None = None  # (4, 4) pose of the camera on its robot, if drawn; otherwise None

    def T_c_o(self, cuboid: Cuboid) -> Array | None:
        """(4, 4) pose of the labelled robot's cuboid in the camera; None if it is absent."""
        if self.T_w_r1 is None:
            return None
        T_c_o: Array = np.linalg.inv(self.scene.T_w_c) @ self.T_w_r1 @ cuboid.T_r_o()
        return T_c_o


def draw_plausible(
    rng: np.random.Generator,
    place: FurnishedPlan,
    looks: RobotLooks,
    observer: RobotSpec,
    draws: PoseDraws,
    *,
    variants: int,
) -> Drawn:
    """The robot on the floor of a furnished room, seen by the camera of another robot there.

    Args:
        rng: draws everything.
        place: a furnished plan.
        looks: the robot that may be seen.
        observer: the robot that carries the camera.
        draws: shares and ranges.
        variants: number of textures of each kind in the pool.

    Raises:
        FloorplanError: there is no room for two robots.
    """
    absent = bool(rng.random() < draws.absent_share)
    poses = draw_robot_poses(rng, place, observer, looks.spec, draws, absent=absent)
    room_looks = draw_room_looks(rng, place, variants=variants)
    # Normal: standard deviations of 3 mm and 0.7 degrees from the camera's nominal pose.
    shift_m, roll_rad, pitch_rad = rng.normal(0.0, [0.003, 0.012, 0.012]).tolist()
    T_r0_c = observer.camera.T_r_c() @ camera_tilt(roll_rad, pitch_rad)
    T_r0_c[2, 3] += shift_m
    occluded = poses.T_w_r1 is not None and bool(rng.random() < draws.occluded_share)
    things = _things_on_floor(
        rng, place, poses, observer, looks.spec, occluded=occluded, draws=draws, variants=variants
    )
    robot = looks.draw(rng, draws.robot, wear=1.0, variants=variants)
    drawn = room_scene(
        rng, place, room_looks, robot, observer.camera.intrinsics(), draws,
        T_w_c=se3_from_se2(poses.T_w_r0) @ T_r0_c, T_w_r1=poses.T_w_r1, things=things,
    )  # fmt: skip
    camera = {"height_shift_m": shift_m, "roll_rad": roll_rad, "pitch_rad": pitch_rad}
    record = {"mode": "plausible", "meeting": plain(poses), "camera": plain(camera), **drawn.record}
    return replace(drawn, record=record, T_r0_c=T_r0_c)


def camera_tilt(roll_rad: float, pitch_rad: float) -> Array:
    """(4, 4) rotation of a camera in its own axes: pitch lowers its view, roll lowers its right side."""
    level = camera_pose(np.zeros(3), np.zeros(3))
    tilted = camera_pose(np.zeros(3), np.array([roll_rad, pitch_rad, 0.0]))
    turn: Array = np.linalg.inv(level) @ tilted
    return turn


def room_scene(
    rng: np.random.Generator,
    place: FurnishedPlan,
    room_looks: RoomLooks,
    robot: Variant,
    camera: PinholeCamera,
    draws: PoseDraws,
    *,
    T_w_c: Array,
    T_w_r1: SE2 | None,
    things: Sequence[PlacedThing] = (),
) -> Drawn:
    """The view of a camera in a furnished plan.

    Args:
        rng: draws light and the camera's effects.
        place: the furnished plan.
        room_looks: its materials.
        robot: the robot that may be seen.
        camera: intrinsics.
        draws: holds the share of images with shadows.
        T_w_c: (4, 4) pose of the camera.
        T_w_r1: pose of the robot that may be seen; None if it is absent.
        things: small things that lie about.
    """
    places_m, shadow = _lamp_places(rng, place, T_w_c), bool(rng.random() < draws.shadow_share)
    lighting = room_lighting(rng, places_m=places_m, ceiling_m=place.wall_height_m, shadow=shadow)
    effects = draw_effects(rng, light_k=lighting.temperature_k())
    pose = None if T_w_r1 is None else se3_from_se2(T_w_r1)
    seen = () if pose is None else robot.instances(pose)
    instances = (*room_instances(place, room_looks), *thing_instances(things), *seen)
    scene = lit_scene(camera, T_w_c, instances, lighting, robot=bool(seen))
    record = drawn_record(lighting, room_looks, robot, things, effects)
    return Drawn(scene=scene, effects=effects, T_w_r1=pose, record=record)


def lit_scene(
    camera: PinholeCamera,
    T_w_c: Array,
    instances: tuple[Instance, ...],
    lighting: Lighting,
    *,
    robot: bool,
    background: Image | None = None,
) -> Scene:
    """The scene of instances under drawn light; robot: whether they include the labelled robot."""
    return Scene(
        camera=camera,
        T_w_c=T_w_c,
        instances=instances,
        lights=tuple(lamp.light() for lamp in lighting.lamps),
        ambient_rgb=lighting.ambient_rgb,
        background=background,
        robot=ROBOT if robot else None,
    )


def drawn_record(
    lighting: Lighting,
    surfaces: RoomLooks | Mapping[str, JsonValue],
    robot: Variant,
    things: Sequence[PlacedThing],
    effects: CameraEffects,
) -> dict[str, JsonValue]:
    """The part of the record that all modes share."""
    return {
        "lighting": plain(lighting),
        "surfaces": plain(surfaces),
        "robot": plain(robot.record),
        "things": plain(list(things)),
        "effects": plain(effects),
    }


def thing_instances(things: Sequence[PlacedThing]) -> list[Instance]:
    """Parts of the things, named `thing-0-kind/0` and so on."""
    return [
        instance
        for i, placed in enumerate(things)
        for instance in placed.thing.instances(placed.T_w_t, name=f"thing-{i}-{placed.thing.kind}")
    ]


def _lamp_places(rng: np.random.Generator, place: FurnishedPlan, T_w_c: Array) -> Array:
    """(3, 2) [m] places for lamps: in the room that the camera sees, or else above the camera."""
    eye_m = T_w_c[:2, 3]
    # Uniform in distance, and in bearing up to a right angle from the camera's view.
    away_m, bearing_rad = rng.uniform(0.3, 3.5, 40), rng.uniform(-0.5 * math.pi, 0.5 * math.pi, 40)
    bearing_rad += math.atan2(T_w_c[1, 2], T_w_c[0, 2])
    places_m = eye_m + away_m[:, None] * np.stack([np.cos(bearing_rad), np.sin(bearing_rad)], axis=1)
    lines = shapely.linestrings(np.stack([np.broadcast_to(eye_m, places_m.shape), places_m], axis=1))
    inside_m = places_m[shapely.covers(place.plan.free_space(), lines)]
    return np.concatenate([inside_m, np.repeat(eye_m[None], 3, axis=0)])[:3]


def _things_on_floor(
    rng: np.random.Generator,
    place: FurnishedPlan,
    poses: RobotPoses,
    observer: RobotSpec,
    seen: RobotSpec,
    *,
    occluded: bool,
    draws: PoseDraws,
    variants: int,
) -> tuple[PlacedThing, ...]:
    """Things in view, Poisson with mean 3; occluded: and one that hides part of the robot."""
    robots = [(poses.T_w_r0, observer), (poses.T_w_r1, seen)]
    taken = [(pose.x_m, pose.y_m, spec.radius_m + 0.01) for pose, spec in robots if pose is not None]
    placed: list[PlacedThing] = []
    for i in range(int(rng.poisson(3.0)) + occluded):
        thing = draw_thing(rng, variants=variants, look_alike_share=draws.look_alike_share)
        hides = i == 0 and occluded
        xy_m = _in_front(rng, poses, thing, seen) if hides else _in_view(rng, poses, thing)
        pose = place_on_floor(rng, thing, free=place.floor, xy_m=xy_m, taken=taken)
        if pose is not None:
            taken.append((pose.x_m, pose.y_m, thing.radius_m))
            placed.append(PlacedThing(thing=thing, T_w_t=se3_from_se2(pose)))
    return tuple(placed)


def _in_view(rng: np.random.Generator, poses: RobotPoses, thing: Thing) -> Array:
    """(N, 2) [m] places: distance and bearing uniform, off the line of sight between the robots."""
    away_m, bearing_rad = rng.uniform(0.4, VIEW_M, 16), rng.uniform(-0.55, 0.55, 16)
    p_r0 = away_m[:, None] * np.stack([np.cos(bearing_rad), np.sin(bearing_rad)], axis=1)
    places_m = poses.T_w_r0 @ p_r0
    if poses.T_w_r1 is None:
        return places_m
    ends_m = [pose.as_array()[:2] for pose in (poses.T_w_r0, poses.T_w_r1)]
    gaps_m = shapely.distance(shapely.LineString(ends_m), shapely.points(places_m))
    off_line: Array = places_m[gaps_m > thing.radius_m]
    return off_line


def _in_front(rng: np.random.Generator, poses: RobotPoses, thing: Thing, seen: RobotSpec) -> Array:
    """(16, 2) [m] places between the robots, far enough to the side to leave part of the robot in view."""
    assert poses.T_w_r1 is not None
    eye_m, target_m = poses.T_w_r0.as_array()[:2], poses.T_w_r1.as_array()[:2]
    share = rng.uniform(0.3, 0.95, 16)[:, None]
    # Uniform; the cone that contains the robot narrows towards the eye.
    edge = rng.uniform(-0.7, 0.9, 16)[:, None] * share * 0.5 * seen.size_m[1]
    aside_m = rng.choice([-1.0, 1.0], 16)[:, None] * (thing.radius_m + edge)
    along = (target_m - eye_m) / np.linalg.norm(target_m - eye_m)
    return eye_m + share * (target_m - eye_m) + aside_m * np.array([-along[1], along[0]])
