"""Unit meshes of small things: base on z = 0, height 1 and at most 1 across, unless stated otherwise."""

from __future__ import annotations

import numpy as np
import trimesh
from shapely import Point

from rendezvous.geometry.se2 import Array
from rendezvous.rendering.robot_model import creased_mesh
from rendezvous.rendering.scene import MeshPool

CABLES = 3
SECTIONS = 28

# (radius, height) from the axis at the bottom to the axis at the top.
_PROFILES = {
    "cone": [(0, 0), (0.5, 0), (0.5, 0.05), (0.37, 0.06), (0.06, 1.0), (0, 1.0)],
    "bottle": [
        (0, 0), (0.46, 0), (0.5, 0.02), (0.5, 0.6), (0.44, 0.7), (0.2, 0.82), (0.17, 0.93), (0.2, 0.94),
        (0.2, 1.0), (0, 1.0),
    ],
    "cup": [
        (0, 0), (0.38, 0), (0.42, 0.03), (0.5, 1.0), (0.46, 1.0), (0.38, 0.08), (0, 0.06),
    ],
    "bowl": [
        (0, 0), (0.22, 0), (0.24, 0.06), (0.4, 0.4), (0.5, 1.0), (0.47, 1.0), (0.36, 0.42), (0.1, 0.12),
        (0, 0.1),
    ],
    "vase": [
        (0, 0), (0.28, 0), (0.34, 0.05), (0.5, 0.35), (0.44, 0.6), (0.2, 0.82), (0.2, 0.9), (0.3, 1.0),
        (0.26, 1.0), (0.15, 0.88), (0, 0.5),
    ],
}  # fmt: skip


def thing_meshes() -> MeshPool:
    """All meshes, keyed `thing/...`; the same in every process."""
    shapes = {name: _turned(np.array(profile, np.float64)) for name, profile in _PROFILES.items()}
    shapes["vase"] = _turned(_rounded(np.array(_PROFILES["vase"], np.float64)))
    shapes |= {"ball": _ball(), "shoe": _shoe(), "bag": _bag(), "leaves": _leaves(), "handle": _handle()}
    shapes |= {f"cable-{i}": _cable(i) for i in range(CABLES)}
    return {f"thing/{name}": (mesh,) for name, mesh in shapes.items()}


def _creased(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    return creased_mesh(np.round(mesh.vertices, 6), np.asarray(mesh.faces))


def _turned(profile: Array) -> trimesh.Trimesh:
    return _creased(trimesh.creation.revolve(profile, sections=SECTIONS))


def _rounded(profile: Array) -> Array:
    """The profile with its corners cut (Chaikin), curved like thrown clay."""
    a, b = profile[:-1], profile[1:]
    cut = np.stack([0.75 * a + 0.25 * b, 0.25 * a + 0.75 * b], axis=1).reshape(-1, 2)
    return np.concatenate([profile[:1], cut, profile[-1:]])


def _sphere(subdivisions: int) -> tuple[Array, trimesh.Trimesh]:
    mesh = trimesh.creation.icosphere(subdivisions=subdivisions, radius=1.0)
    return np.asarray(mesh.vertices, np.float64), mesh


def _ball() -> trimesh.Trimesh:
    p, mesh = _sphere(3)
    mesh.vertices = 0.5 * p + (0.0, 0.0, 0.5)
    return _creased(mesh)


def _shoe() -> trimesh.Trimesh:
    """A shoe along x, toe forward; 1 long, 0.36 wide, 0.42 high."""
    p, mesh = _sphere(3)
    x, y, z = p.T
    # High at the ankle, falling towards the toe.
    top = 0.17 + 0.25 / (1.0 + np.exp(7.0 * (x + 0.25)))
    height = top * np.sqrt(np.maximum(z, 0.0))
    waist = 0.16 + 0.02 * np.cos(3.0 * x)
    mesh.vertices = np.column_stack([0.5 * np.sign(x) * np.abs(x) ** 0.8, waist * y, height])
    return _creased(mesh)


def _bag() -> trimesh.Trimesh:
    """A rounded block with a sagging top."""
    p, mesh = _sphere(3)
    block = np.sign(p) * np.abs(p) ** 0.45
    block[:, :2] *= 1.0 - 0.18 * (block[:, 2:] > 0.0) * block[:, 2:]
    mesh.vertices = 0.5 * block + (0.0, 0.0, 0.5)
    return _creased(mesh)


def _handle() -> trimesh.Trimesh:
    """The handle of the unit cup: a ring in the x-z plane, half inside the wall."""
    ring = trimesh.creation.torus(major_radius=0.28, minor_radius=0.05, major_sections=20, minor_sections=8)
    ring.apply_transform(trimesh.transformations.rotation_matrix(0.5 * np.pi, [1.0, 0.0, 0.0]))
    ring.apply_translation([0.5, 0.0, 0.52])
    return _creased(ring)


def _leaves() -> trimesh.Trimesh:
    """Two dozen bent two-sided blades from one root."""
    blades = []
    for i in range(24):
        # The golden angle spreads them evenly.
        turn_rad, lean = 2.39996 * i, 0.15 + 0.85 * ((i * 7) % 24) / 24.0
        t = np.linspace(0.0, 1.0, 6)
        reach, rise = 0.5 * lean * t**1.4, (1.0 - 0.45 * lean) * t - 0.35 * lean * t**3
        width = 0.05 * np.sin(np.pi * (0.08 + 0.92 * t)) ** 0.7
        c, s = np.cos(turn_rad), np.sin(turn_rad)
        spine = np.column_stack([c * reach, s * reach, np.maximum(rise, 0.0)])
        side = np.outer(width, [-s, c, 0.0])
        blades.append(_ribbon(spine - side, spine + side))
    return trimesh.util.concatenate(blades)


def _ribbon(left: Array, right: Array) -> trimesh.Trimesh:
    n = len(left)
    i = np.arange(n - 1)
    front = np.concatenate([np.stack([i, i + n, i + 1], 1), np.stack([i + 1, i + n, i + n + 1], 1)])
    vertices = np.concatenate([left, right])
    one = trimesh.Trimesh(vertices=vertices, faces=front, process=False)
    other = trimesh.Trimesh(vertices=vertices, faces=front[:, ::-1], process=False)
    return trimesh.util.concatenate([one, other])


def _cable(variant: int) -> trimesh.Trimesh:
    """A cable on the floor in true size: 8 mm thick, about 0.6 m across."""
    t = np.linspace(0.0, 1.0, 48)
    phase = 1.9 * variant
    angle_rad = phase + (1.2 + variant) * 2.0 * np.pi * t
    radius_m = 0.09 + 0.2 * t + 0.03 * np.sin(9.0 * t + phase)
    path = np.column_stack([radius_m * np.cos(angle_rad), radius_m * np.sin(angle_rad), np.full(48, 0.004)])
    tube = trimesh.creation.sweep_polygon(Point(0.0, 0.0).buffer(0.004, quad_segs=2), path)
    return _creased(tube)
