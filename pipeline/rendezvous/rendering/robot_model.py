"""A robot's model: named parts with PBR materials in the robot's frame r, stored as GLB.

Nothing here is specific to one robot. A GLB may come from a build script (`assets/robots/burger/build.py`) or
from elsewhere, as long as it is in metres, in r (origin on the floor between the wheels, x forward, z up) and
inside the cuboid of the robot file.
"""

from __future__ import annotations

import io
from collections import defaultdict
from collections.abc import Mapping
from typing import TypeVar

import numpy as np
import scipy.interpolate
import shapely
import trimesh
from numpy.typing import NDArray
from shapely import affinity
from trimesh.visual.material import PBRMaterial

from rendezvous.errors import ConfigError
from rendezvous.geometry.se2 import Array
from rendezvous.rendering.scene import Material
from rendezvous.simulation.robot import Cuboid

P = TypeVar("P")

CREASE_RAD = np.radians(35.0)  # faces that meet at a larger angle keep a sharp edge

INSIDE_TOLERANCE_M = 1e-4
LEAST_FILLED = 0.5

UPRIGHT: Array = np.eye(4)

DEVICES = ("camera", "lidar")
"""Kinds of parts of which a robot has one model or another."""


class SolidParts:
    """Builds a robot's parts from simple solids, for build scripts.

    Args:
        materials: the material of each part, by name.
    """

    def __init__(self, materials: Mapping[str, Material]) -> None:
        self.materials = materials
        self.meshes: dict[str, list[trimesh.Trimesh]] = defaultdict(list)

    def box(self, part: str, size_m: tuple[float, ...], centre_m: tuple[float, ...]) -> None:
        """A block with slightly bevelled edges."""
        bevel_m = 0.12 * min(size_m)
        outline = shapely.box(-size_m[0] / 2, -size_m[1] / 2, size_m[0] / 2, size_m[1] / 2)
        outline = outline.buffer(-bevel_m).buffer(bevel_m, quad_segs=1)
        self.extrude(part, affinity.translate(outline, *centre_m[:2]), centre_m[2] - size_m[2] / 2, size_m[2])

    def extrude(
        self, part: str, outline: shapely.Polygon, z_m: float, height_m: float, T_r_axis: Array = UPRIGHT
    ) -> None:
        """A prism along the z axis of the given frame."""
        mesh = trimesh.creation.extrude_polygon(outline, height_m, engine="earcut")
        self.meshes[part].append(mesh.apply_translation([0.0, 0.0, z_m]).apply_transform(T_r_axis))

    def revolve(
        self, part: str, profile_m: list[tuple[float, float]], sections: int, T_r_axis: Array
    ) -> None:
        """A solid of revolution: profile of (radius, height) along the z axis of the given frame."""
        mesh = trimesh.creation.revolve(np.array(profile_m), sections=sections)
        self.meshes[part].append(mesh.apply_transform(T_r_axis))

    def tube(self, part: str, points_m: Array, radius_m: float) -> None:
        """A round tube along a smooth curve through points (N, 3), at least four."""
        curve = scipy.interpolate.make_interp_spline(np.linspace(0.0, 1.0, len(points_m)), points_m, k=3)
        path = curve(np.linspace(0.0, 1.0, 4 * len(points_m)))
        outline = shapely.Point(0, 0).buffer(radius_m, quad_segs=2)
        self.meshes[part].append(trimesh.creation.sweep_polygon(outline, path, engine="earcut"))

    def parts(self) -> dict[str, tuple[trimesh.Trimesh, Material]]:
        """The mesh and material of every part that has a mesh."""
        return {n: (trimesh.util.concatenate(m), self._material(n)) for n, m in self.meshes.items()}

    def _material(self, part: str) -> Material:
        """The material under the part's own name, or else under the longest of its leading words."""
        words = part.split(".")
        names = [".".join(words[:n]) for n in range(len(words), 0, -1)]
        return next(self.materials[name] for name in names if name in self.materials)


def at(x_m: float, y_m: float, z_m: float, *, z_axis: tuple[float, float, float] = (0.0, 0.0, 1.0)) -> Array:
    """(4, 4) frame at a point with its z axis along a direction."""
    T = np.array(trimesh.geometry.align_vectors([0.0, 0.0, 1.0], z_axis))
    T[:3, 3] = x_m, y_m, z_m
    return T


def robot_glb(parts: Mapping[str, tuple[trimesh.Trimesh, Material]]) -> bytes:
    """A GLB of named parts in r; equal parts give equal bytes.

    Vertices are rounded to a micrometre, so that rounding errors do not change the file.
    """
    scene = trimesh.Scene()
    for name, (mesh, material) in sorted(parts.items()):
        creased = creased_mesh(_rounded(mesh.vertices, 6), np.asarray(mesh.faces))
        creased.visual = trimesh.visual.TextureVisuals(
            material=PBRMaterial(
                name=name,
                baseColorFactor=[*material.base_colour_rgb, 1.0],
                metallicFactor=material.metallic,
                roughnessFactor=material.roughness,
            )
        )
        scene.add_geometry(creased, node_name=name, geom_name=name)
    return bytes(trimesh.exchange.gltf.export_glb(scene, include_normals=True))


def robot_parts(glb: bytes, *, source: str) -> dict[str, trimesh.Trimesh]:
    """The parts of a robot by name, sorted, in r [m], each with its own PBR material.

    Args:
        glb: content of a binary glTF file.
        source: its name in errors.

    Raises:
        ConfigError: the bytes are not a GLB or contain no mesh.
    """
    try:
        scene = trimesh.load_scene(io.BytesIO(glb), file_type="glb")
    except Exception as error:  # a damaged file can make the reader raise anything
        raise ConfigError(f"{source}: {len(glb)} bytes that cannot be read as GLB ({error})") from error
    parts: dict[str, trimesh.Trimesh] = {}
    for node in scene.graph.nodes_geometry:
        T_r_part, geometry = scene.graph[node]
        mesh = scene.geometry[geometry]
        if not isinstance(mesh, trimesh.Trimesh):
            continue
        parts[node] = mesh if np.array_equal(T_r_part, np.eye(4)) else mesh.copy().apply_transform(T_r_part)
    if not parts:
        raise ConfigError(f"{source}: no mesh in the GLB; a robot must have at least one")
    return dict(sorted(parts.items()))


def nominal_parts(parts: Mapping[str, P]) -> dict[str, P]:
    """A robot's parts with the first, by name, of the models of each device that it has.

    The second word in the name of a lidar's or camera's part is its model: `lidar.lds01.head`.
    """
    models = [model for name in parts if (model := model_of(name)) is not None]
    first = {kind: min(m for k, m in models if k == kind) for kind, _ in models}
    return {n: p for n, p in parts.items() if (model := model_of(n)) is None or first[model[0]] == model[1]}


def model_of(part: str) -> tuple[str, str] | None:
    """Kind of device and its model, by the name of a part; None for parts of which there is one choice."""
    words = part.split(".")
    return (words[0], words[1]) if words[0] in DEVICES and len(words) > 1 else None


def part_material(part: trimesh.Trimesh) -> Material:
    """A part's own material without its texture, with glTF's defaults; white plastic if it has none."""
    own = getattr(part.visual, "material", None)
    if not isinstance(own, PBRMaterial):
        return Material(base_colour_rgb=(1.0, 1.0, 1.0))
    factor = np.ones(4) if own.baseColorFactor is None else np.asarray(own.baseColorFactor)
    if np.issubdtype(factor.dtype, np.integer):  # trimesh stores glTF's linear factor as bytes
        factor = factor / 255.0
    return Material(
        base_colour_rgb=(float(factor[0]), float(factor[1]), float(factor[2])),
        metallic=1.0 if own.metallicFactor is None else float(own.metallicFactor),
        roughness=1.0 if own.roughnessFactor is None else float(own.roughnessFactor),
    )


def check_inside_cuboid(parts: Mapping[str, trimesh.Trimesh], cuboid: Cuboid, *, robot: str) -> None:
    """Check that the cuboid, from which labels are drawn, contains the robot and is not far too large.

    Raises:
        ConfigError: a part sticks out of the cuboid, or the parts together span less than half of one side.
    """
    centre_m, half_m = np.array(cuboid.centre_m), 0.5 * np.array(cuboid.size_m)
    for name, part in parts.items():
        beyond_m = np.abs(np.asarray(part.bounds) - centre_m) - half_m
        if beyond_m.max() > INSIDE_TOLERANCE_M:
            axis = "xyz"[int(beyond_m.max(axis=0).argmax())]
            raise ConfigError(
                f"robot {robot}: part {name!r} reaches {1e3 * beyond_m.max():.1f} mm out of the cuboid along "
                f"{axis}; is the model in metres and in the frame between the wheels?"
            )
    bounds_m = np.array([part.bounds for part in parts.values()])
    filled = (bounds_m[:, 1].max(axis=0) - bounds_m[:, 0].min(axis=0)) / np.array(cuboid.size_m)
    if filled.min() < LEAST_FILLED:
        axis = "xyz"[int(filled.argmin())]
        raise ConfigError(
            f"robot {robot}: the model fills {filled.min():.1%} of the cuboid along {axis}, must be at least "
            f"{LEAST_FILLED:.0%}; is it in metres?"
        )


def creased_mesh(vertices: Array, faces: NDArray[np.int64]) -> trimesh.Trimesh:
    """The mesh with smooth normals on curved surfaces and split vertices along sharp edges.

    A corner's normal is the area-weighted mean over the faces at its vertex that are within `CREASE_RAD` of
    its own face.
    """
    vertices, merged = np.unique(vertices, axis=0, return_inverse=True)
    faces = merged.reshape(-1)[faces]
    area = np.cross(
        vertices[faces[:, 1]] - vertices[faces[:, 0]], vertices[faces[:, 2]] - vertices[faces[:, 0]]
    )
    length = np.linalg.norm(area, axis=1)
    kept = length > 1e-12
    faces, area, length = faces[kept], area[kept], length[kept]
    normal = area / length[:, None]
    corner_vertex, corner_face = faces.ravel(), np.repeat(np.arange(len(faces)), 3)
    normals = _corner_normals(corner_vertex, corner_face, normal, area)
    rows = np.column_stack([vertices[corner_vertex], _rounded(normals, 4)])
    unique, index = np.unique(rows, axis=0, return_inverse=True)
    return trimesh.Trimesh(
        vertices=unique[:, :3], faces=index.reshape(-1, 3), vertex_normals=unique[:, 3:], process=False
    )


def _rounded(values: Array, decimals: int) -> Array:
    """Rounded, without negative zeros, whose sign depends on rounding errors."""
    return np.round(values, decimals) + 0.0


def _corner_normals(
    corner_vertex: NDArray[np.int64], corner_face: NDArray[np.int64], normal: Array, area: Array
) -> Array:
    """(3F, 3) unit normals, one per corner of each face."""
    order = np.argsort(corner_vertex, kind="stable")
    starts = np.flatnonzero(np.diff(corner_vertex[order], prepend=-1))
    normals = np.empty((len(corner_vertex), 3))
    for corners in np.split(order, starts[1:]):
        around = corner_face[corners]
        alike = normal[around] @ normal[around].T > np.cos(CREASE_RAD)
        mean = alike.astype(np.float64) @ area[around]
        normals[corners] = mean / np.linalg.norm(mean, axis=1, keepdims=True)
    return normals
