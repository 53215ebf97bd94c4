"""Small things that lie about in rooms, drawn at random in true size, and places for them on the floor.

Frame t: on the floor at the centre of the thing, z up.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
import shapely

from rendezvous.geometry.camera import se3_from_se2
from rendezvous.geometry.se2 import SE2, Array
from rendezvous.rendering.appearance import materials
from rendezvous.rendering.appearance.materials import Draw
from rendezvous.rendering.machines import other_robot, rack, speaker, vacuum_cleaner, waste_bin
from rendezvous.rendering.plan_scene import CYLINDER
from rendezvous.rendering.scene import Material
from rendezvous.rendering.thing import Thing, ThingDraw, ThingPart, block, sized
from rendezvous.rendering.thing_meshes import CABLES


def _round(
    kind: str, diameter_m: tuple[float, float], height_m: tuple[float, float], draws: tuple[Draw, ...]
) -> ThingDraw:
    """Draws things of one turned mesh; sizes uniform, the material by one of the draws."""

    def make(rng: np.random.Generator, variants: int) -> Thing:
        d_m, h_m = rng.uniform(*diameter_m), rng.uniform(*height_m)
        material = draws[rng.integers(len(draws))](rng, variants)
        part = ThingPart(mesh=f"thing/{kind}", T_t=sized(d_m, d_m, h_m), material=material)
        return Thing(kind=kind, parts=(part,), radius_m=0.5 * d_m, height_m=h_m)

    return make


def _carton(rng: np.random.Generator, variants: int) -> Thing:
    """A cardboard box or a crate."""
    x_m, y_m, z_m = rng.uniform(0.08, 0.38), rng.uniform(0.08, 0.3), rng.uniform(0.05, 0.3)
    draw = materials.cardboard if rng.random() < 0.7 else materials.anything_material
    part = block(x_m, y_m, z_m, draw(rng, variants))
    return Thing(kind="carton", parts=(part,), radius_m=0.5 * math.hypot(x_m, y_m), height_m=z_m)


def _book_pile(rng: np.random.Generator, variants: int) -> Thing:
    """One to five books, each turned a little: covers, pages and spine."""
    parts: list[ThingPart] = []
    up_m = reach_m = 0.0
    paper = Material(base_colour_rgb=materials.linear_rgb((0.9, 0.87, 0.8)), roughness=0.95)
    for _ in range(int(rng.integers(1, 6))):
        x_m, y_m, z_m = rng.uniform(0.15, 0.3), rng.uniform(0.11, 0.21), rng.uniform(0.012, 0.045)
        yaw_rad, cover = rng.normal(0.0, 0.3), materials.plastic(rng, variants)
        parts += [
            block(x_m, y_m, 0.003, cover, up_m=up_m, yaw_rad=yaw_rad),
            block(x_m - 0.012, y_m - 0.012, z_m - 0.006, paper, up_m=up_m + 0.003, yaw_rad=yaw_rad),
            block(x_m, y_m, 0.003, cover, up_m=up_m + z_m - 0.003, yaw_rad=yaw_rad),
            block(
                x_m, 0.004, z_m - 0.006, cover, up_m=up_m + 0.003, yaw_rad=yaw_rad, aside_m=0.5 * y_m - 0.002
            ),
        ]
        up_m, reach_m = up_m + z_m, max(reach_m, 0.5 * math.hypot(x_m, y_m))
    return Thing(kind="books", parts=tuple(parts), radius_m=reach_m, height_m=up_m)


def _cup(rng: np.random.Generator, variants: int) -> Thing:
    """A mug with a handle."""
    d_m, h_m = rng.uniform(0.07, 0.1), rng.uniform(0.08, 0.12)
    material = (materials.ceramic if rng.random() < 0.4 else materials.plastic)(rng, variants)
    T_t = sized(d_m, d_m, h_m)
    parts = tuple(ThingPart(mesh=f"thing/{m}", T_t=T_t, material=material) for m in ("cup", "handle"))
    return Thing(kind="cup", parts=parts, radius_m=0.83 * d_m, height_m=h_m)


def _can(rng: np.random.Generator, variants: int) -> Thing:
    """A tin or a paint bucket."""
    d_m = rng.uniform(0.06, 0.22)
    h_m = d_m * rng.uniform(0.9, 1.9)
    material = (materials.metal if rng.random() < 0.5 else materials.plastic)(rng, variants)
    part = ThingPart(mesh=CYLINDER, T_t=sized(d_m, d_m, h_m, up_m=0.5 * h_m), material=material)
    return Thing(kind="can", parts=(part,), radius_m=0.5 * d_m, height_m=h_m)


def _shoes(rng: np.random.Generator, variants: int) -> Thing:
    """A pair of shoes, not quite side by side, with soles."""
    length_m, upper = rng.uniform(0.2, 0.31), materials.anything_material(rng, variants)
    sole = Material(base_colour_rgb=materials.linear_rgb(np.full(3, rng.uniform(0.1, 0.9))), roughness=0.9)
    parts: list[ThingPart] = []
    for side in (-0.5, 0.5):
        T_t = se3_from_se2(
            SE2(rng.normal(0.0, 0.03), side * length_m * rng.uniform(0.45, 0.7), rng.normal(0.0, 0.25))
        )
        T_t[2, 3] = 0.018
        parts.append(ThingPart(mesh="thing/shoe", T_t=T_t @ np.diag([length_m] * 3 + [1.0]), material=upper))
        under = np.diag([1.02 * length_m, 0.36 * length_m, 0.02, 1.0])
        T_t = T_t.copy()
        T_t[2, 3] = 0.01
        parts.append(ThingPart(mesh=CYLINDER, T_t=T_t @ under, material=sole))
    return Thing(kind="shoes", parts=tuple(parts), radius_m=0.85 * length_m + 0.06, height_m=0.45 * length_m)


def _pot_plant(rng: np.random.Generator, variants: int) -> Thing:
    """Leaves in a pot with soil."""
    d_m, pot_m, leaves_m = rng.uniform(0.09, 0.26), rng.uniform(0.08, 0.24), rng.uniform(0.15, 0.5)
    spread_m = rng.uniform(0.8, 1.4) * leaves_m
    draw = (materials.plastic, materials.ceramic, materials.painted)[rng.integers(3)]
    earth = Material(base_colour_rgb=materials.linear_rgb((0.2, 0.14, 0.1)), roughness=1.0)
    parts = (
        ThingPart(mesh="thing/cup", T_t=sized(d_m, d_m, pot_m), material=draw(rng, variants)),
        ThingPart(mesh=CYLINDER, T_t=sized(0.86 * d_m, 0.86 * d_m, 0.01, up_m=0.85 * pot_m), material=earth),
        ThingPart(
            mesh="thing/leaves",
            T_t=sized(spread_m, spread_m, leaves_m, up_m=0.85 * pot_m),
            material=materials.leaf(rng, variants),
        ),
    )
    return Thing(
        kind="plant", parts=parts, radius_m=0.5 * max(d_m, spread_m), height_m=0.85 * pot_m + leaves_m
    )


def _cable(rng: np.random.Generator, variants: int) -> Thing:
    """A loosely coiled cable: black, white, grey or coloured."""
    scale = rng.uniform(0.5, 1.2)
    value = rng.choice([0.08, 0.9, 0.5])
    material = (
        Material(base_colour_rgb=materials.linear_rgb(np.full(3, value)), roughness=0.6)
        if rng.random() < 0.8
        else materials.plastic(rng, variants)
    )
    mesh = f"thing/cable-{rng.integers(CABLES)}"
    part = ThingPart(mesh=mesh, T_t=sized(scale, scale, rng.uniform(0.7, 1.1)), material=material)
    return Thing(kind="cable", parts=(part,), radius_m=0.33 * scale, height_m=0.009)


def _bag(rng: np.random.Generator, variants: int) -> Thing:
    """A backpack or a bag."""
    x_m, y_m, z_m = rng.uniform(0.22, 0.4), rng.uniform(0.14, 0.25), rng.uniform(0.2, 0.42)
    part = ThingPart(mesh="thing/bag", T_t=sized(x_m, y_m, z_m), material=materials.fabric(rng, variants))
    return Thing(kind="bag", parts=(part,), radius_m=0.5 * math.hypot(x_m, y_m), height_m=z_m)


def _ball(rng: np.random.Generator, variants: int) -> Thing:
    """A ball, from a tennis ball to a football."""
    d_m = rng.uniform(0.06, 0.24)
    material = (materials.plastic if rng.random() < 0.7 else materials.fabric)(rng, variants)
    part = ThingPart(mesh="thing/ball", T_t=sized(d_m, d_m, d_m), material=material)
    return Thing(kind="ball", parts=(part,), radius_m=0.5 * d_m, height_m=d_m)


THINGS: Mapping[str, ThingDraw] = {
    "carton": _carton,
    "books": _book_pile,
    "cup": _cup,
    "can": _can,
    "shoes": _shoes,
    "plant": _pot_plant,
    "cable": _cable,
    "bag": _bag,
    "ball": _ball,
    "cone": _round("cone", (0.15, 0.28), (0.2, 0.5), (materials.plastic,)),
    "bottle": _round("bottle", (0.06, 0.1), (0.18, 0.34), (materials.plastic, materials.metal)),
    "bowl": _round(
        "bowl", (0.12, 0.26), (0.05, 0.1), (materials.ceramic, materials.plastic, materials.metal)
    ),
    "vacuum": vacuum_cleaner,
    "speaker": speaker,
    "bin": waste_bin,
    "robot": other_robot,
    "rack": rack,
    "vase": _round("vase", (0.1, 0.24), (0.18, 0.5), (materials.ceramic, materials.painted)),
}


LOOK_ALIKES = ("vacuum", "speaker", "bin", "robot", "rack")


def draw_thing(rng: np.random.Generator, *, variants: int, look_alike_share: float = 0.0) -> Thing:
    """A thing of uniformly drawn kind; this share, and those among the others, look like the robot."""
    kinds = tuple(THINGS)
    if look_alike_share and rng.random() < look_alike_share:
        kinds = LOOK_ALIKES
    return THINGS[kinds[rng.integers(len(kinds))]](rng, variants)


def place_on_floor(
    rng: np.random.Generator,
    thing: Thing,
    *,
    free: shapely.Geometry,
    xy_m: Array,
    taken: Sequence[tuple[float, float, float]],
) -> SE2 | None:
    """Pose at the first place where the thing touches nothing, with uniform heading; None if there is none.

    Args:
        rng: draws the heading.
        thing: the thing to place.
        free: floor without walls and furniture [m].
        xy_m: (N, 2) places to try.
        taken: x, y, radius [m] of circles already occupied.
    """
    yaw_rad = float(rng.uniform(-math.pi, math.pi))
    far = np.ones(len(xy_m), np.bool_)
    for x_m, y_m, radius_m in taken:
        far &= np.hypot(xy_m[:, 0] - x_m, xy_m[:, 1] - y_m) > radius_m + thing.radius_m
    for x_m, y_m in xy_m[far].tolist():
        if free.covers(shapely.Point(x_m, y_m).buffer(thing.radius_m)):
            return SE2(x_m, y_m, yaw_rad)
    return None
