"""Machines that are not the robot but look like one from afar: what a detector must not fall for.

Small things as in `distractors`: frame t, on the floor at the centre of the thing, z up.
"""

from __future__ import annotations

import math

import numpy as np

from rendezvous.geometry.camera import se3_from_se2
from rendezvous.geometry.se2 import SE2, Array
from rendezvous.rendering.appearance import materials
from rendezvous.rendering.plan_scene import BOX, CYLINDER
from rendezvous.rendering.scene import Material
from rendezvous.rendering.thing import Thing, ThingPart, block, sized

RUBBER = Material(base_colour_rgb=(0.015, 0.015, 0.016), roughness=0.9)


def _drum(
    d_m: float, h_m: float, up_m: float, material: Material, xy_m: tuple[float, float] = (0.0, 0.0)
) -> ThingPart:
    """An upright cylinder with its bottom at `up_m`."""
    T_t = sized(d_m, d_m, h_m, up_m=up_m + 0.5 * h_m)
    T_t[:2, 3] = xy_m
    return ThingPart(mesh=CYLINDER, T_t=T_t, material=material)


def _wheel(d_m: float, width_m: float, x_m: float, y_m: float) -> ThingPart:
    """A wheel on the floor whose axle is along y."""
    T_t: Array = se3_from_se2(SE2(x_m, y_m, 0.0))
    T_t[2, 3] = 0.5 * d_m
    turn = np.array([[1, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1]], np.float64)
    return ThingPart(mesh=CYLINDER, T_t=T_t @ turn @ np.diag([d_m, d_m, width_m, 1.0]), material=RUBBER)


def _shell(rng: np.random.Generator, variants: int) -> Material:
    """Black, white or coloured plastic; black for half of all machines, as the robot is."""
    if rng.random() < 0.5:
        return Material(
            base_colour_rgb=materials.grey(rng.uniform(0.08, 0.25)), roughness=rng.uniform(0.3, 0.7)
        )
    return materials.plastic(rng, variants)


def vacuum_cleaner(rng: np.random.Generator, variants: int) -> Thing:
    """A robot vacuum cleaner: a low disc with a bumper, often with a lidar's turret."""
    d_m, h_m = rng.uniform(0.26, 0.36), rng.uniform(0.07, 0.1)
    body, ring = _shell(rng, variants), _shell(rng, variants)
    parts = [_drum(d_m, 0.7 * h_m, 0.0, ring), _drum(0.96 * d_m, 0.3 * h_m, 0.7 * h_m, body)]
    top_m = h_m
    if rng.random() < 0.6:
        parts.append(_drum(0.09, 0.02, top_m, _shell(rng, variants), (-0.1 * d_m, 0.0)))
        top_m += 0.02
    return Thing(kind="vacuum", parts=tuple(parts), radius_m=0.5 * d_m, height_m=top_m)


def speaker(rng: np.random.Generator, variants: int) -> Thing:
    """A loudspeaker: a box with one to three cones in front, or a drum."""
    material = _shell(rng, variants)
    if rng.random() < 0.3:
        d_m, h_m = rng.uniform(0.08, 0.16), rng.uniform(0.1, 0.24)
        drum = (_drum(d_m, 0.85 * h_m, 0.0, material), _drum(0.9 * d_m, 0.15 * h_m, 0.85 * h_m, RUBBER))
        return Thing(kind="speaker", parts=drum, radius_m=0.5 * d_m, height_m=h_m)
    x_m, y_m, z_m = rng.uniform(0.1, 0.22), rng.uniform(0.1, 0.2), rng.uniform(0.16, 0.36)
    cones = []
    count = int(rng.integers(1, 4))
    for i in range(count):
        d_m = rng.uniform(0.5, 0.85) * min(y_m, z_m / count)
        T_t = np.array([[0, 0, 1, 0.5 * x_m], [1, 0, 0, 0], [0, 1, 0, z_m * (i + 0.5) / count], [0, 0, 0, 1]])
        cones.append(ThingPart(mesh=CYLINDER, T_t=T_t @ np.diag([d_m, d_m, 0.006, 1.0]), material=RUBBER))
    parts = (block(x_m, y_m, z_m, material), *cones)
    return Thing(kind="speaker", parts=parts, radius_m=0.5 * math.hypot(x_m, y_m), height_m=z_m)


def waste_bin(rng: np.random.Generator, variants: int) -> Thing:
    """A small waste bin, open or with a lid."""
    d_m, h_m = rng.uniform(0.16, 0.3), rng.uniform(0.18, 0.4)
    material = _shell(rng, variants) if rng.random() < 0.6 else materials.metal(rng, variants)
    parts = [ThingPart(mesh="thing/cup", T_t=sized(d_m, d_m, h_m), material=material)]
    if rng.random() < 0.4:
        parts.append(_drum(d_m, 0.02, h_m, _shell(rng, variants)))
    return Thing(kind="bin", parts=tuple(parts), radius_m=0.5 * d_m, height_m=h_m + 0.02)


def rack(rng: np.random.Generator, variants: int) -> Thing:
    """A small rack: plates on posts, with things on some: a shelf, a trolley, a stack of trays."""
    x_m, y_m = rng.uniform(0.11, 0.34, 2)
    plate, post = _shell(rng, variants), _shell(rng, variants)
    if rng.random() < 0.4:
        post = materials.metal(rng, variants)
    plate_m, post_m = rng.uniform(0.003, 0.014), rng.uniform(0.006, 0.022)
    inset_m = rng.uniform(0.0, 0.2) * min(x_m, y_m)
    places = [
        (sx * (0.5 * (x_m - post_m) - inset_m), sy * (0.5 * (y_m - post_m) - inset_m))
        for sx in (1, -1)
        for sy in (1, -1)
    ]
    is_round = rng.random() < 0.2  # one post in the middle instead, as of a stand for cakes
    parts, up_m, foot_m = [], 0.0, rng.uniform(0.0, 0.09)
    for layer in range(int(rng.integers(2, 6))):
        gap_m = foot_m if layer == 0 else rng.uniform(0.03, 0.16)
        if gap_m > 0.01:
            parts += [_drum(post_m, gap_m, up_m, post, xy) for xy in ([(0.0, 0.0)] if is_round else places)]
        up_m += gap_m
        top = _drum(x_m, plate_m, up_m, plate) if is_round else block(x_m, y_m, plate_m, plate, up_m=up_m)
        parts.append(top)
        up_m += plate_m
        if rng.random() < 0.35:
            share = rng.uniform(0.3, 0.7, 3)
            parts.append(block(share[0] * x_m, share[1] * y_m, 0.03, _shell(rng, variants), up_m=up_m))
    reach_m = 0.5 * (x_m if is_round else math.hypot(x_m, y_m)) + 0.01
    return Thing(kind="rack", parts=tuple(parts), radius_m=reach_m, height_m=up_m + 0.03)


def other_robot(rng: np.random.Generator, variants: int) -> Thing:
    """A robot of another make: plates on posts over a round base, a box on four wheels, or a tower."""
    draw = (_plate_robot, _rover, _tower)[rng.integers(3)]
    return draw(rng, variants)


def _plate_robot(rng: np.random.Generator, variants: int) -> Thing:
    """A base with wheels and plates on posts, wider than the Burger."""
    side_m, base_m = rng.uniform(0.2, 0.36), rng.uniform(0.04, 0.1)
    plate, post = _shell(rng, variants), materials.metal(rng, variants)
    is_round = rng.random() < 0.6
    wheel_m = rng.uniform(0.05, 0.09)
    parts = [_wheel(wheel_m, 0.02, 0.0, side * 0.5 * side_m) for side in (1.0, -1.0)]
    up_m = 0.015

    def layer(high_m: float, material: Material) -> ThingPart:
        if is_round:
            return _drum(side_m, high_m, up_m, material)
        return block(side_m, side_m, high_m, material, up_m=up_m)

    parts.append(layer(base_m, _shell(rng, variants)))
    up_m += base_m
    reach_m = 0.3 * side_m
    for _ in range(int(rng.integers(1, 4))):
        gap_m = rng.uniform(0.05, 0.14)
        for x, y in ((1, 1), (1, -1), (-1, 1), (-1, -1)):
            parts.append(_drum(0.008, gap_m, up_m, post, (reach_m * x, reach_m * y)))
        up_m += gap_m
        parts.append(layer(0.006, plate))
        up_m += 0.006
    if rng.random() < 0.5:
        d_m = rng.uniform(0.06, 0.11)
        parts.append(_drum(d_m, 0.05, up_m, _shell(rng, variants), (rng.uniform(-0.05, 0.05), 0.0)))
        up_m += 0.05
    reach_m = 0.5 * side_m * (1.0 if is_round else math.sqrt(2.0)) + 0.02
    return Thing(kind="robot", parts=tuple(parts), radius_m=reach_m, height_m=up_m)


def _rover(rng: np.random.Generator, variants: int) -> Thing:
    """A box on four wheels, with a camera on a mast or a lidar on top."""
    x_m, y_m, z_m = rng.uniform(0.18, 0.36), rng.uniform(0.12, 0.24), rng.uniform(0.05, 0.12)
    wheel_m = rng.uniform(0.06, 0.13)
    up_m = 0.3 * wheel_m
    parts = [block(x_m, y_m, z_m, _shell(rng, variants), up_m=up_m)]
    wheels_y_m = 0.5 * y_m + 0.015
    parts += [_wheel(wheel_m, 0.03, sx * 0.35 * x_m, sy * wheels_y_m) for sx in (1, -1) for sy in (1, -1)]
    top_m = up_m + z_m
    if rng.random() < 0.5:
        mast_m = rng.uniform(0.05, 0.2)
        parts.append(_drum(0.012, mast_m, top_m, materials.metal(rng, variants), (0.3 * x_m, 0.0)))
        parts.append(block(0.03, 0.09, 0.03, _shell(rng, variants), up_m=top_m + mast_m))
        top_m += mast_m + 0.03
    else:
        parts.append(_drum(rng.uniform(0.06, 0.09), 0.045, top_m, _shell(rng, variants)))
        top_m += 0.045
    reach_m = math.hypot(0.5 * x_m, wheels_y_m + 0.015) + 0.01
    return Thing(kind="robot", parts=tuple(parts), radius_m=reach_m, height_m=top_m)


def _tower(rng: np.random.Generator, variants: int) -> Thing:
    """A tapering service robot or smart speaker on a base."""
    d_m, h_m = rng.uniform(0.14, 0.3), rng.uniform(0.25, 0.7)
    parts = [
        _drum(d_m, 0.12 * h_m, 0.0, _shell(rng, variants)),
        _drum(0.7 * d_m, 0.68 * h_m, 0.12 * h_m, _shell(rng, variants)),
    ]
    parts.append(_drum(0.5 * d_m, 0.2 * h_m, 0.8 * h_m, _shell(rng, variants)))
    parts += [_wheel(0.06, 0.02, 0.0, side * 0.5 * d_m) for side in (1.0, -1.0)]
    screen = ThingPart(
        mesh=BOX,
        T_t=_at(0.36 * d_m, 0.65 * h_m) @ np.diag([0.004, 0.5 * d_m, 0.2 * h_m, 1.0]),
        material=RUBBER,
    )
    return Thing(kind="robot", parts=(*parts, screen), radius_m=0.5 * d_m + 0.02, height_m=h_m)


def _at(x_m: float, z_m: float) -> Array:
    T_t = np.eye(4)
    T_t[0, 3], T_t[2, 3] = x_m, z_m
    return T_t
