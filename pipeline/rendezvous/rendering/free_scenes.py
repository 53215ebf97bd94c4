"""Random scenes that need not be plausible: the robot in any pose on any background, as in DOPE's training.

The camera looks along the x axis of w from 1 m above its origin; the robot and small things float in the air.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from rendezvous.geometry.camera import Image, PinholeCamera, camera_pose, rotation_from_rpy
from rendezvous.geometry.se2 import Array
from rendezvous.rendering.appearance import materials
from rendezvous.rendering.appearance.lighting import free_lighting
from rendezvous.rendering.backgrounds import draw_background
from rendezvous.rendering.distractors import draw_thing
from rendezvous.rendering.draws import PoseDraws
from rendezvous.rendering.effects import WHITE_K, draw_effects
from rendezvous.rendering.plan_scene import QUAD
from rendezvous.rendering.randomise import (
    Drawn,
    PlacedThing,
    RobotLooks,
    drawn_record,
    lit_scene,
    thing_instances,
)
from rendezvous.rendering.record import JsonValue, plain
from rendezvous.rendering.scene import Instance
from rendezvous.simulation.robot import RobotSpec

T_W_C: Array = camera_pose(np.array([0.0, 0.0, 1.0]), np.zeros(3))
GROUND_SHARE = 0.5
MAX_THINGS = 7


def draw_free(
    rng: np.random.Generator,
    looks: RobotLooks,
    camera: PinholeCamera,
    textures: Mapping[str, Image],
    draws: PoseDraws,
    *,
    variants: int,
    photos: Sequence[Image] = (),
) -> Drawn:
    """The robot in any pose, half the time on a ground, with things around it.

    Args:
        rng: draws everything.
        looks: the robot.
        camera: intrinsics.
        textures: the texture pool.
        draws: shares and ranges.
        variants: number of textures of each kind in the pool.
        photos: (H, W, 3) uint8 for the background; procedural rooms if there are none.
    """
    absent = bool(rng.random() < draws.absent_share)
    T_w_r1 = draw_pose(rng, looks.spec, camera, draws)
    centre_w = (T_w_r1 @ looks.spec.cuboid.T_r_o())[:3, 3]
    occluded = bool(rng.random() < draws.occluded_share)
    things = _things_around(rng, centre_w, looks.spec, camera, occluded=occluded, variants=variants)
    ground = _draw_ground(rng, T_w_r1, variants=variants)
    lighting = free_lighting(rng, target_m=centre_w, shadow=bool(rng.random() < draws.shadow_share))
    worn = looks.worn(rng, extent=1.5)
    # The background was lit in white.
    effects = draw_effects(rng, light_k=WHITE_K)
    size = {"width_px": camera.width_px, "height_px": camera.height_px}
    background, background_record = draw_background(rng, textures, photos, **size)
    robot = () if absent else looks.instances(T_w_r1, worn)
    instances = (*ground, *thing_instances(things), *robot)
    scene = lit_scene(camera, T_W_C, instances, lighting, robot=not absent, background=background)
    own: dict[str, JsonValue] = {
        "mode": "free",
        "absent": absent,
        "T_w_r1": plain(T_w_r1),
        "background": dict(background_record),
    }
    surfaces = {quad.name: {"T_w": plain(quad.T_w), "material": plain(quad.material)} for quad in ground}
    record = own | drawn_record(lighting, surfaces, worn, things, effects)
    return Drawn(scene=scene, effects=effects, T_w_r1=None if absent else T_w_r1, record=record)


def draw_pose(rng: np.random.Generator, seen: RobotSpec, camera: PinholeCamera, draws: PoseDraws) -> Array:
    """(4, 4) `T_w_r1`: distance uniform, pixel uniform over the image and a margin around it.

    Three in four have any heading, seen from up to 55 degrees above with a roll of about 8; the others are
    rotated uniformly on SO(3).
    """
    range_m = rng.uniform(draws.min_range_m, draws.max_range_m)
    margin_px = 0.35 * camera.fx_px * seen.size_m[1] / range_m
    u_px = rng.uniform(-margin_px, camera.width_px + margin_px)
    v_px = rng.uniform(-margin_px, camera.height_px + margin_px)
    T_w_o = np.eye(4)
    T_w_o[:3, 3] = _at(camera, u_px, v_px, range_m)
    if rng.random() < 0.75:
        roll_rad, down_rad = rng.normal(0.0, 0.14), rng.uniform(-0.1, 0.96)
        level = rotation_from_rpy(0.0, 0.0, rng.uniform(-math.pi, math.pi))
        T_w_o[:3, :3] = rotation_from_rpy(roll_rad, -down_rad, 0.0) @ level
    else:
        T_w_o[:3, :3] = _any_rotation(rng)
    T_w_r1: Array = T_w_o @ np.linalg.inv(seen.cuboid.T_r_o())
    return T_w_r1


def _at(camera: PinholeCamera, u_px: float, v_px: float, range_m: float) -> Array:
    """(3,) [m] point in w at this pixel and distance."""
    ray_c = np.array([(u_px - camera.cx_px) / camera.fx_px, (v_px - camera.cy_px) / camera.fy_px, 1.0])
    place: Array = T_W_C[:3, :3] @ (range_m * ray_c / np.linalg.norm(ray_c)) + T_W_C[:3, 3]
    return place


def _any_rotation(rng: np.random.Generator) -> Array:
    """(3, 3) rotation uniform on SO(3), by a unit quaternion of normal draws."""
    w, x, y, z = (q := rng.normal(size=4)) / np.linalg.norm(q)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def _across(rng: np.random.Generator, along: Array) -> Array:
    """(3,) unit vector perpendicular to another, uniform."""
    across = np.cross(along, rng.normal(size=3))
    unit: Array = across / np.linalg.norm(across)
    return unit


def _draw_ground(rng: np.random.Generator, T_w_r1: Array, *, variants: int) -> tuple[Instance, ...]:
    """Half the time a square under the wheels, 1 to 6 m wide, uniform; invisible from below."""
    if rng.random() >= GROUND_SHARE:
        return ()
    side_m, material = rng.uniform(1.0, 6.0), materials.any_texture_material(rng, variants)
    T_w = T_w_r1 @ np.diag([side_m, side_m, 1.0, 1.0])
    return (Instance(name="ground", mesh=QUAD, T_w=T_w, material=material),)


def _things_around(
    rng: np.random.Generator,
    centre_w: Array,
    seen: RobotSpec,
    camera: PinholeCamera,
    *,
    occluded: bool,
    variants: int,
) -> tuple[PlacedThing, ...]:
    """Up to seven things anywhere in view; occluded: and one in front of the robot's edge."""
    eye_w = T_W_C[:3, 3]
    robot_m = 0.5 * float(np.linalg.norm(seen.cuboid.size_m))
    count = int(rng.integers(MAX_THINGS + 1))
    placed: list[PlacedThing] = []
    for i in range(count + occluded):
        thing = draw_thing(rng, variants=variants)
        reach_m = math.hypot(thing.radius_m, 0.5 * thing.height_m)
        if i == 0 and occluded:
            share = rng.uniform(0.45, 0.8)
            # Uniform; far enough to the side to leave part of the robot in view.
            aside_m = reach_m + rng.uniform(-0.9, 0.5) * share * robot_m
            at_w = eye_w + share * (centre_w - eye_w) + aside_m * _across(rng, centre_w - eye_w)
        else:
            u_px, v_px = rng.uniform(0.0, camera.width_px), rng.uniform(0.0, camera.height_px)
            at_w = _at(camera, u_px, v_px, rng.uniform(0.6, 5.0))
        if (
            np.linalg.norm(at_w - centre_w) < reach_m + robot_m
            or np.linalg.norm(at_w - eye_w) < 2.0 * reach_m
        ):
            continue
        T_w_t = np.eye(4)
        T_w_t[:3, :3] = _any_rotation(rng)
        T_w_t[:3, 3] = at_w - T_w_t[:3, 2] * 0.5 * thing.height_m
        placed.append(PlacedThing(thing=thing, T_w_t=T_w_t))
    return tuple(placed)
