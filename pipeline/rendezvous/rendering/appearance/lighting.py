"""Lamps of rooms, drawn at random. At brightness 1, a white wall is just white in a picture."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from rendezvous.geometry.cuboid import Vec3
from rendezvous.geometry.se2 import Array
from rendezvous.rendering.appearance.colour import blackbody_rgb
from rendezvous.rendering.scene import Light, LightKind, Rgb


@dataclass(frozen=True, slots=True, kw_only=True)
class Lamp:
    """A lamp as drawn."""

    kind: LightKind  # directional, spot or point
    xyz_m: Vec3  # position in w
    aim: Vec3  # unit vector along which it shines
    temperature_k: float  # colour temperature
    # Brightness of a white surface lit straight on: anywhere for a directional lamp, at `reach_m` for the
    # others.
    brightness: float
    reach_m: float  # distance to what it is meant to light; 1 for a directional lamp
    casts_shadow: bool = False  # whether it casts shadows
    cone_rad: float = 1.0  # half angle of a spot's cone

    def light(self) -> Light:
        """The lamp as a light of a scene."""
        T_w = np.eye(4)
        T_w[:3, :3] = _rotation_shining(np.array(self.aim))
        T_w[:3, 3] = self.xyz_m
        colour = blackbody_rgb(self.temperature_k)
        top = float(colour.max())
        return Light(
            kind=self.kind,
            T_w=T_w,
            colour_rgb=_triple(colour / top),
            intensity=math.pi * self.brightness * self.reach_m**2 * top,
            casts_shadow=self.casts_shadow,
            cone_rad=self.cone_rad,
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class Lighting:
    """All light of a scene: lamps, and the ambient light from walls and sky."""

    lamps: tuple[Lamp, ...]
    ambient_rgb: Rgb

    def temperature_k(self) -> float:
        """Overall colour temperature: mean over the lamps in mired, weighted by brightness."""
        weights = [lamp.brightness for lamp in self.lamps]
        mired = np.average([1e6 / lamp.temperature_k for lamp in self.lamps], weights=weights)
        return 1e6 / float(mired)


def room_lighting(rng: np.random.Generator, *, places_m: Array, ceiling_m: float, shadow: bool) -> Lighting:
    """One to three lamps under the ceiling, and the sun in a third of rooms.

    Args:
        rng: draws them.
        places_m: (N, 2) points on the room's floor, in random order; lamps hang above the first.
        ceiling_m: height of the ceiling.
        shadow: whether the first lamp casts shadows.
    """
    # Uniform in mired, from 2700 to 6500 K; lamps of one room differ little.
    mired = rng.uniform(154.0, 370.0)
    # Log-uniform: rooms of one house differ by more than a factor of two.
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
    return Lighting(lamps=tuple(lamps), ambient_rgb=_triple(ambient * colour / colour.max()))


def free_lighting(rng: np.random.Generator, *, target_m: Array, shadow: bool) -> Lighting:
    """One to four lamps of any kind around a point (3,), more often above it than below."""
    brightness = math.exp(rng.uniform(math.log(0.35), math.log(1.4)))
    count = int(rng.integers(1, 5))
    share = rng.dirichlet(np.full(count, 2.0))
    lamps = [
        _lamp_around(rng, target_m, brightness * share[i], shadow=shadow and i == 0) for i in range(count)
    ]
    ambient = brightness * rng.uniform(0.15, 0.7) * rng.uniform(0.75, 1.0, size=3)
    return Lighting(lamps=tuple(lamps), ambient_rgb=_triple(ambient))


def _ceiling_lamp(
    rng: np.random.Generator, xy_m: Array, mired: float, brightness: float, ceiling_m: float, *, shadow: bool
) -> Lamp:
    """A bulb, or a wide spot if it is to cast shadows; height uniform, temperature normal in mired."""
    z_m = ceiling_m - rng.uniform(0.1, 0.6)
    lean = rng.normal(0.0, 0.12, size=2)
    return Lamp(
        kind=LightKind.SPOT if shadow else LightKind.POINT,
        xyz_m=_triple(np.array([*xy_m, z_m])),
        aim=_unit(np.array([*lean, -1.0])),
        temperature_k=1e6 / float(np.clip(mired + rng.normal(0.0, 8.0), 100.0, 450.0)),
        brightness=brightness,
        reach_m=z_m,
        casts_shadow=shadow,
        cone_rad=rng.uniform(0.95, 1.2),
    )


def _sun(rng: np.random.Generator, brightness: float, *, shadow: bool) -> Lamp:
    """Parallel light: azimuth uniform, elevation uniform from 25 to 65 degrees."""
    azimuth_rad, height_rad = rng.uniform(-math.pi, math.pi), rng.uniform(0.44, 1.13)
    flat = math.cos(height_rad)
    aim = np.array([flat * math.cos(azimuth_rad), flat * math.sin(azimuth_rad), -math.sin(height_rad)])
    return Lamp(
        kind=LightKind.DIRECTIONAL,
        xyz_m=(0.0, 0.0, 0.0),
        aim=_unit(aim),
        temperature_k=rng.uniform(4800.0, 7000.0),
        brightness=brightness,
        reach_m=1.0,
        casts_shadow=shadow,
    )


def _lamp_around(rng: np.random.Generator, target_m: Array, brightness: float, *, shadow: bool) -> Lamp:
    """Direction uniform on the sphere, two in three moved to the upper half; temperature uniform in mired."""
    away = np.array(_unit(rng.normal(size=3)))
    if rng.random() < 0.66:
        away[2] = abs(away[2])
    kinds = (LightKind.DIRECTIONAL, LightKind.SPOT) if shadow else tuple(LightKind)
    kind = kinds[rng.integers(len(kinds))]
    reach_m = rng.uniform(1.0, 3.5)
    return Lamp(
        kind=kind,
        xyz_m=_triple(target_m + reach_m * away),
        aim=_unit(-away),
        temperature_k=1e6 / rng.uniform(110.0, 420.0),
        brightness=brightness,
        reach_m=1.0 if kind is LightKind.DIRECTIONAL else reach_m,
        casts_shadow=shadow,
        cone_rad=rng.uniform(0.5, 1.1),
    )


def _unit(vector: Array) -> Vec3:
    return _triple(vector / np.linalg.norm(vector))


def _triple(values: Array) -> tuple[float, float, float]:
    a, b, c = values.tolist()
    return a, b, c


def _rotation_shining(aim: Array) -> Array:
    """(3, 3) rotation whose -z axis is the aim."""
    z = -aim
    beside = np.array([1.0, 0.0, 0.0]) if abs(z[0]) < 0.9 else np.array([0.0, 1.0, 0.0])
    y = np.cross(z, beside)
    y /= np.linalg.norm(y)
    return np.column_stack([np.cross(y, z), y, z])
