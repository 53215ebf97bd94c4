"""Random scenes that need not be plausible: the robot in any pose on any background, as in DOPE's training.

The camera looks along the x axis of w from 1 m above its origin; the robot and small things float in the air.
Behind them is a painted room, out of focus, or one of the user's photos.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import cv2
import numpy as np

from rendezvous.geometry.camera import Image, PinholeCamera, camera_pose, rotation_from_rpy
from rendezvous.geometry.se2 import Array
from rendezvous.rendering.appearance import materials
from rendezvous.rendering.appearance.colour import srgb_from_linear
from rendezvous.rendering.appearance.lighting import free_lighting
from rendezvous.rendering.appearance.materials import cloth_tint, wall_tint
from rendezvous.rendering.appearance.noise import Field
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


SHARPEST_PX, SOFTEST_PX = 1.2, 9.0  # range of the blur's standard deviation


def photo_background(rng: np.random.Generator, photo: Image, *, width_px: int, height_px: int) -> Image:
    """A crop of a photo (H, W, 3), scaled to the size; position and scale uniform, mirrored half the time."""
    height, width = photo.shape[:2]
    widest = min(width / width_px, height / height_px)
    scale = widest * rng.uniform(0.6, 1.0)
    cut_w, cut_h = max(int(width_px * scale), 1), max(int(height_px * scale), 1)
    left, top = int(rng.integers(width - cut_w + 1)), int(rng.integers(height - cut_h + 1))
    cut = photo[top : top + cut_h, left : left + cut_w]
    cut = cut[:, ::-1] if rng.random() < 0.5 else cut
    interpolation = cv2.INTER_AREA if scale > 1.0 else cv2.INTER_LINEAR
    return np.asarray(
        cv2.resize(np.ascontiguousarray(cut), (width_px, height_px), interpolation=interpolation)
    )


def room_background(
    rng: np.random.Generator, textures: Mapping[str, Image], *, width_px: int, height_px: int
) -> Image:
    """A wall, a floor and things in front of the wall, out of focus, painted with textures of the pool."""
    # Painted at half the size, since all of it is blurred.
    width, height = width_px // 2, height_px // 2
    surfaces = list(textures.values())
    grounds = [image for key, image in textures.items() if not key.startswith("books")]
    horizon = int(height * rng.uniform(0.15, 0.75))
    image = np.empty((height, width, 3), np.float32)
    image[:horizon] = _tint(wall_tint(rng)) * _patch(rng, surfaces, width, horizon, deep=False)
    image[horizon:] = _tint(cloth_tint(rng)) * _patch(rng, grounds, width, height - horizon, deep=True)
    for _ in range(int(rng.integers(2, 9))):
        _add_object(rng, image, surfaces, horizon)
    image *= _daylight(rng, width, height)[..., None]
    # Mean brightness uniform.
    image *= np.float32(rng.uniform(0.25, 0.6) / max(float(image.mean()), 0.05))
    # Log-uniform, from slightly soft to mere patches of colour.
    sigma_px = float(np.exp(rng.uniform(np.log(SHARPEST_PX), np.log(SOFTEST_PX))))
    soft = cv2.GaussianBlur(image, (0, 0), 0.5 * sigma_px)
    coded = np.clip(255.0 * soft, 0.0, 255.0).astype(np.uint8)
    return np.asarray(cv2.resize(coded, (width_px, height_px), interpolation=cv2.INTER_LINEAR))


def draw_background(
    rng: np.random.Generator,
    textures: Mapping[str, Image],
    photos: Sequence[Image],
    *,
    width_px: int,
    height_px: int,
) -> tuple[Image, Mapping[str, JsonValue]]:
    """A background and its record: the index of the photo, if there are any, and the seed of its draws."""
    seed = int(rng.integers(2**31))
    own = np.random.default_rng(seed)
    if photos:
        index = int(own.integers(len(photos)))
        image = photo_background(own, photos[index], width_px=width_px, height_px=height_px)
        return image, {"photo": index, "seed": seed}
    image = room_background(own, textures, width_px=width_px, height_px=height_px)
    return image, {"photo": None, "seed": seed}


def _tint(linear: tuple[float, float, float]) -> Field:
    return srgb_from_linear(np.array(linear)).astype(np.float32)


def _patch(
    rng: np.random.Generator, textures: Sequence[Image], width_px: int, height_px: int, *, deep: bool
) -> Field:
    """(H, W, 3) in [0, 1]: a patch of a texture; deep: receding towards the upper edge."""
    texture = textures[int(rng.integers(len(textures)))]
    v, u = np.mgrid[:height_px, :width_px].astype(np.float32)
    zoom = np.float32(rng.uniform(1.2, 4.0))
    if deep:
        depth = np.float32(height_px) / (v + np.float32(0.06 * height_px))
        u, v = (u - np.float32(0.5 * width_px)) * depth * zoom * np.float32(0.4), 60.0 * depth * zoom
    size = np.float32(len(texture))
    sampled = cv2.remap(
        texture, np.mod(u * zoom, size), np.mod(v * zoom, size), cv2.INTER_LINEAR, borderMode=cv2.BORDER_WRAP
    )
    return (sampled / 255.0).astype(np.float32)


def _add_object(rng: np.random.Generator, image: Field, textures: Sequence[Image], horizon: int) -> None:
    """Paint a cupboard, window, picture or lamp into the image: a rectangle or ellipse of one material."""
    height_px, width_px = image.shape[:2]
    wide, high = int(width_px * rng.uniform(0.05, 0.4)), int(height_px * rng.uniform(0.08, 0.6))
    left = int(rng.integers(-wide // 2, width_px - wide // 2))
    bottom = horizon + int(height_px * rng.uniform(-0.3, 0.2))
    rows = slice(max(bottom - high, 0), min(bottom, height_px))
    cols = slice(max(left, 0), min(left + wide, width_px))
    seen = image[rows, cols]
    if seen.size == 0:
        return
    window = rng.random() < 0.2
    tint = np.full(3, rng.uniform(0.9, 1.3), np.float32) if window else _tint(cloth_tint(rng))
    patch = tint if window else tint * _patch(rng, textures, seen.shape[1], seen.shape[0], deep=False)
    shade = np.linspace(rng.uniform(0.7, 1.1), rng.uniform(0.7, 1.1), seen.shape[1], dtype=np.float32)
    shaded = np.broadcast_to(patch * shade[None, :, None], seen.shape)
    v, u = np.ogrid[rows, cols]
    across, down = (u - left - 0.5 * wide) / (0.5 * wide), (v - bottom + 0.5 * high) / (0.5 * high)
    inside = across**2 + down**2 < 1.0 if rng.random() < 0.25 else np.full(seen.shape[:2], True)
    seen[inside] = shaded[inside]


def _daylight(rng: np.random.Generator, width_px: int, height_px: int) -> Field:
    """(H, W) brightness that falls off from a point, like a lamp or window."""
    v, u = np.mgrid[:height_px, :width_px].astype(np.float32)
    at_u, at_v = rng.uniform(0.0, width_px), rng.uniform(-0.3, 0.6) * height_px
    away = np.hypot(u - at_u, v - at_v) / width_px
    return (rng.uniform(0.45, 0.8) + rng.uniform(0.2, 0.7) * np.exp(-3.0 * away)).astype(np.float32)
