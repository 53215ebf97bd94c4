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
from rendezvous.rendering.backgrounds import BackgroundStyle, draw_background
from rendezvous.rendering.distractors import draw_thing
from rendezvous.rendering.draws import PoseDraws
from rendezvous.rendering.effects import WHITE_K, draw_effects
from rendezvous.rendering.plan_scene import QUAD
from rendezvous.rendering.randomise import (
    Drawn,
    PlacedThing,
    drawn_record,
    lit_scene,
    thing_instances,
)
from rendezvous.rendering.record import JsonValue, plain
from rendezvous.rendering.robot_family import RobotLooks
from rendezvous.rendering.scene import Instance
from rendezvous.simulation.robot import RobotSpec

T_W_C: Array = camera_pose(np.array([0.0, 0.0, 1.0]), np.zeros(3))
GROUND_SHARE = 0.5
MAX_THINGS = 7

PHOTO_SIZES_PX = ((320, 240), (640, 480), (640, 360), (960, 720), (1280, 720))
PHOTO_STYLES = (BackgroundStyle.WHITE, BackgroundStyle.BUSY, BackgroundStyle.ANY)


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
    """The robot in any pose, half the time on a ground, with things around it; or as people photograph it.

    Args:
        rng: draws everything.
        looks: the robot.
        camera: intrinsics; photographs are taken with other cameras.
        textures: the texture pool.
        draws: shares and ranges.
        variants: number of textures of each kind in the pool.
        photos: (H, W, 3) uint8 for the background; procedural rooms if there are none.
    """
    absent = bool(rng.random() < draws.absent_share)
    style = BackgroundStyle.ANY
    if rng.random() < draws.photo_share:
        camera = draw_photo_camera(rng)
        T_w_r1 = draw_photo_pose(rng, looks.spec, camera)
        style = PHOTO_STYLES[rng.integers(len(PHOTO_STYLES))]
    else:
        T_w_r1 = draw_pose(rng, looks.spec, camera, draws)
    centre_w = (T_w_r1 @ looks.spec.cuboid.T_r_o())[:3, 3]
    occluded = bool(rng.random() < draws.occluded_share)
    things = _things_around(
        rng, centre_w, looks.spec, camera, occluded=occluded, draws=draws, variants=variants
    )
    white = style is BackgroundStyle.WHITE
    ground = _draw_ground(rng, T_w_r1, white=white, variants=variants)
    lighting = free_lighting(rng, target_m=centre_w, shadow=bool(rng.random() < draws.shadow_share))
    robot = looks.draw(rng, draws.robot, wear=1.5, variants=variants)
    # The background was lit in white.
    effects = draw_effects(rng, light_k=WHITE_K)
    size = {"width_px": camera.width_px, "height_px": camera.height_px}
    background, background_record = draw_background(rng, textures, photos, style=style, **size)
    seen = () if absent else robot.instances(T_w_r1)
    instances = (*ground, *thing_instances(things), *seen)
    scene = lit_scene(camera, T_W_C, instances, lighting, robot=not absent, background=background)
    own: dict[str, JsonValue] = {
        "mode": "free",
        "absent": absent,
        "T_w_r1": plain(T_w_r1),
        "background": dict(background_record),
        "camera": plain(camera),
    }
    surfaces = {quad.name: {"T_w": plain(quad.T_w), "material": plain(quad.material)} for quad in ground}
    record = own | drawn_record(lighting, surfaces, robot, things, effects)
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


def draw_photo_camera(rng: np.random.Generator) -> PinholeCamera:
    """A camera of one of several image sizes, with a view 45 to 90 degrees wide, uniform."""
    width_px, height_px = PHOTO_SIZES_PX[rng.integers(len(PHOTO_SIZES_PX))]
    f_px = 0.5 * width_px / math.tan(0.5 * math.radians(rng.uniform(45.0, 90.0)))
    cx_px, cy_px = 0.5 * (width_px - 1), 0.5 * (height_px - 1)
    return PinholeCamera(
        fx_px=f_px, fy_px=f_px, cx_px=cx_px, cy_px=cy_px, width_px=width_px, height_px=height_px
    )


def draw_photo_pose(rng: np.random.Generator, seen: RobotSpec, camera: PinholeCamera) -> Array:
    """(4, 4) `T_w_r1`: any heading, seen from 10 to 40 degrees above, from far to too near for the frame."""
    share = math.exp(rng.uniform(math.log(0.12), math.log(1.4)))
    range_m = max(camera.fy_px * seen.size_m[2] / (share * camera.height_px), 0.25)
    reach_px = 0.5 * (1.0 - min(share, 0.8)) * np.array([camera.width_px, camera.height_px])
    aside_px = rng.uniform(-reach_px, reach_px)
    T_w_o = np.eye(4)
    T_w_o[:3, 3] = _at(camera, camera.cx_px + aside_px[0], camera.cy_px + aside_px[1], range_m)
    roll_rad, down_rad = rng.normal(0.0, 0.05), math.radians(rng.uniform(10.0, 40.0))
    level = rotation_from_rpy(0.0, 0.0, rng.uniform(-math.pi, math.pi))
    T_w_o[:3, :3] = rotation_from_rpy(roll_rad, -down_rad, 0.0) @ level
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


def _draw_ground(
    rng: np.random.Generator, T_w_r1: Array, *, white: bool, variants: int
) -> tuple[Instance, ...]:
    """Half the time a square under the wheels, 1 to 6 m wide, uniform; invisible from below."""
    if rng.random() >= GROUND_SHARE:
        return ()
    side_m, draw = rng.uniform(1.0, 6.0), materials.ceramic if white else materials.any_texture_material
    material = draw(rng, variants)
    T_w = T_w_r1 @ np.diag([side_m, side_m, 1.0, 1.0])
    return (Instance(name="ground", mesh=QUAD, T_w=T_w, material=material),)


def _things_around(
    rng: np.random.Generator,
    centre_w: Array,
    seen: RobotSpec,
    camera: PinholeCamera,
    *,
    occluded: bool,
    draws: PoseDraws,
    variants: int,
) -> tuple[PlacedThing, ...]:
    """Up to seven things anywhere in view; occluded: and one in front of the robot's edge."""
    eye_w = T_W_C[:3, 3]
    robot_m = 0.5 * float(np.linalg.norm(seen.cuboid.size_m))
    count = int(rng.integers(MAX_THINGS + 1))
    placed: list[PlacedThing] = []
    for i in range(count + occluded):
        thing = draw_thing(rng, variants=variants, look_alike_share=draws.look_alike_share)
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
