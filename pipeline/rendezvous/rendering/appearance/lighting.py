"""Lamps of rooms, drawn at random. Brightness 1 is what makes a white wall white in a picture."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from rendezvous.geometry.se2 import Array
from rendezvous.rendering.appearance.colour import blackbody_rgb
from rendezvous.rendering.scene import Light, LightKind, Rgb

Vec3 = tuple[float, float, float]

"""Share of images in which a lamp throws shadows."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Lamp:
    """A lamp as it was drawn.

    Attributes:
        kind: directional, spot or point.
        xyz_m: where it is, in w.
        aim: unit vector along which it shines.
        temperature_k: of its light.
        brightness: of a white surface that it shines on squarely: anywhere for a directional lamp, at
            `reach_m` for the others.
        reach_m: distance to what it is there to light; 1 for a directional lamp.
        casts_shadow: whether it throws shadows.
        cone_rad: half angle of a spot's cone.
    """

    kind: LightKind
    xyz_m: Vec3
    aim: Vec3
    temperature_k: float
    brightness: float
    reach_m: float
    casts_shadow: bool = False
    cone_rad: float = 1.0

    def light(self) -> Light:
        """It as scenes have it."""
        T_w = np.eye(4)
        T_w[:3, :3] = _rotation_shining(np.array(self.aim))
        T_w[:3, 3] = self.xyz_m
        colour = blackbody_rgb(self.temperature_k)
        top = float(colour.max())
        return Light(
            kind=self.kind,
            T_w=T_w,
            colour_rgb=_rgb(colour / top),
            intensity=math.pi * self.brightness * self.reach_m**2 * top,
            casts_shadow=self.casts_shadow,
            cone_rad=self.cone_rad,
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class Lighting:
    """All light of a scene: lamps, and what walls and sky throw back from everywhere."""

    lamps: tuple[Lamp, ...]
    ambient_rgb: Rgb

    def temperature_k(self) -> float:
        """Of all light together: mean of the lamps', by brightness, in mired."""
        weights = [lamp.brightness for lamp in self.lamps]
        mired = np.average([1e6 / lamp.temperature_k for lamp in self.lamps], weights=weights)
        return 1e6 / float(mired)


def room_lighting(rng: np.random.Generator, *, places_m: Array, ceiling_m: float, shadow: bool) -> Lighting:
    """One to three lamps under the ceiling, and for a third of rooms the sun.

    Args:
        rng: draws them.
        places_m: (N, 2) floor of the room that the picture is of, in random order; lamps hang above it.
        ceiling_m: height of the ceiling.
        shadow: whether the first of them throws shadows.
    """
    # Uniform in mired: 2700 to 6500 K; lamps of one room differ little.
    mired = rng.uniform(154.0, 370.0)
    # Log-uniform: the rooms of a house differ by more than a factor of two.
    brightness = math.exp(rng.uniform(math.log(0.35), math.log(1.1)))
    sun = rng.random() < 0.33
    count = int(rng.choice([1, 2, 3], p=[0.4, 0.4, 0.2]))
    share = rng.dirichlet(np.full(count, 4.0))
    lamps = [
        _ceiling_lamp(
            rng, xy_m, mired, brightness * share[i], ceiling_m, shadow=shadow and not sun and i == 0
        )
        for i, xy_m in enumerate(places_m[:count])
    ]
    if sun:
        lamps.insert(0, _sun(rng, brightness * rng.uniform(0.4, 1.0), shadow=shadow))
    ambient = brightness * rng.uniform(0.25, 0.7)
    colour = blackbody_rgb(1e6 / mired) ** 0.6
    return Lighting(lamps=tuple(lamps), ambient_rgb=_rgb(ambient * colour / colour.max()))


def free_lighting(rng: np.random.Generator, *, target_m: Array, shadow: bool) -> Lighting:
    """One to four lamps of any kind around a point (3,), from above more often than from below."""
    brightness = math.exp(rng.uniform(math.log(0.35), math.log(1.4)))
    count = int(rng.integers(1, 5))
    share = rng.dirichlet(np.full(count, 2.0))
    lamps = [
        _lamp_around(rng, target_m, brightness * share[i], shadow=shadow and i == 0) for i in range(count)
    ]
    ambient = brightness * rng.uniform(0.15, 0.7) * rng.uniform(0.75, 1.0, size=3)
    return Lighting(lamps=tuple(lamps), ambient_rgb=_rgb(ambient))


def _ceiling_lamp(
    rng: np.random.Generator, xy_m: Array, mired: float, brightness: float, ceiling_m: float, *, shadow: bool
) -> Lamp:
    """A bulb, or, if it is to throw shadows, a wide spot; heights uniform, temperature normal."""
    z_m = ceiling_m - rng.uniform(0.1, 0.6)
    lean = rng.normal(0.0, 0.12, size=2)
    return Lamp(
        kind=LightKind.SPOT if shadow else LightKind.POINT,
        xyz_m=(float(xy_m[0]), float(xy_m[1]), z_m),
        aim=_unit(np.array([*lean, -1.0])),
        temperature_k=1e6 / float(np.clip(mired + rng.normal(0.0, 8.0), 100.0, 450.0)),
        brightness=brightness,
        reach_m=z_m,
        casts_shadow=shadow,
        cone_rad=rng.uniform(0.95, 1.2),
    )


def _sun(rng: np.random.Generator, brightness: float, *, shadow: bool) -> Lamp:
    """Parallel light from any side, 25 to 65 degrees high: uniform."""
    azimuth_rad, height_rad = rng.uniform(-math.pi, math.pi), rng.uniform(0.44, 1.13)
    flat = math.cos(height_rad)
    return Lamp(
        kind=LightKind.DIRECTIONAL,
        xyz_m=(0.0, 0.0, 0.0),
        aim=_unit(
            np.array([flat * math.cos(azimuth_rad), flat * math.sin(azimuth_rad), -math.sin(height_rad)])
        ),
        temperature_k=rng.uniform(4800.0, 7000.0),
        brightness=brightness,
        reach_m=1.0,
        casts_shadow=shadow,
    )


def _lamp_around(rng: np.random.Generator, target_m: Array, brightness: float, *, shadow: bool) -> Lamp:
    """Direction uniform on the sphere, two of three lamps from below turned up; temperature in mired."""
    away = np.array(_unit(rng.normal(size=3)))
    if rng.random() < 0.66:
        away[2] = abs(away[2])
    kinds = (LightKind.DIRECTIONAL, LightKind.SPOT) if shadow else tuple(LightKind)
    kind = kinds[rng.integers(len(kinds))]
    reach_m = rng.uniform(1.0, 3.5)
    x_m, y_m, z_m = (target_m + reach_m * away).tolist()
    return Lamp(
        kind=kind,
        xyz_m=(x_m, y_m, z_m),
        aim=_unit(-away),
        temperature_k=1e6 / rng.uniform(110.0, 420.0),
        brightness=brightness,
        reach_m=1.0 if kind is LightKind.DIRECTIONAL else reach_m,
        casts_shadow=shadow,
        cone_rad=rng.uniform(0.5, 1.1),
    )


def _unit(vector: Array) -> Vec3:
    x, y, z = (vector / np.linalg.norm(vector)).tolist()
    return x, y, z


def _rgb(colour: Array) -> Rgb:
    red, green, blue = colour.tolist()
    return red, green, blue


def _rotation_shining(aim: Array) -> Array:
    """(3, 3) rotation whose -z axis is the aim."""
    z = -aim
    beside = np.array([1.0, 0.0, 0.0]) if abs(z[0]) < 0.9 else np.array([0.0, 1.0, 0.0])
    y = np.cross(z, beside)
    y /= np.linalg.norm(y)
    return np.column_stack([np.cross(y, z), y, z])
