"""Watertight meshes of a furnished floor plan, and the GLB file of them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import shapely
import trimesh

from rendezvous.floorplan.records import Floorplan, Shape, Solid
from rendezvous.floorplan.walls import storey_polygon, wall_polygon
from rendezvous.geometry.se2 import Array

WALL_THICKNESS_M = 0.15
FLOOR_THICKNESS_M = 0.02
CYLINDER_SECTIONS = 24

# glTF's y axis points up; w has z up. Columns: the axes of w in glTF's frame.
T_GLTF_W: Array = np.array(
    [[1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, -1.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]]
)


def floorplan_scene(floorplan: Floorplan, solids: Sequence[Solid], *, height_m: float) -> trimesh.Scene:
    """The plan in w, z up: nodes `floor`, `walls`, and one per piece of furniture (`003-table`).

    Walls are closed volumes from the floor to `height_m`. A piece of furniture is the union of closed
    volumes, one per solid, in one mesh.
    """
    wall = wall_polygon(floorplan, thickness_m=WALL_THICKNESS_M)
    ground = storey_polygon(floorplan, thickness_m=WALL_THICKNESS_M)
    floor = _extruded(ground, FLOOR_THICKNESS_M).apply_translation([0.0, 0.0, -FLOOR_THICKNESS_M])
    meshes = {"floor": floor, "walls": _extruded(wall, height_m)}
    for item in sorted({solid.item for solid in solids}):
        parts = [solid for solid in solids if solid.item == item]
        meshes[f"{item:03d}-{parts[0].category}"] = trimesh.util.concatenate(list(map(_solid_mesh, parts)))
    scene = trimesh.Scene()
    for name, mesh in meshes.items():
        scene.add_geometry(mesh, node_name=name, geom_name=name)
    return scene


def glb(scene: trimesh.Scene) -> bytes:
    """The scene as a binary glTF file, turned to glTF's y-up axes; equal scenes give equal bytes."""
    turned = scene.copy()
    turned.apply_transform(T_GLTF_W)
    data: bytes = turned.export(file_type="glb")
    return data


def _extruded(polygon: shapely.Polygon | shapely.MultiPolygon, height_m: float) -> trimesh.Trimesh:
    parts = [trimesh.creation.extrude_polygon(part, height=height_m) for part in shapely.get_parts(polygon)]
    return trimesh.util.concatenate(parts)


def _solid_mesh(solid: Solid) -> trimesh.Trimesh:
    height_m = solid.z1_m - solid.z0_m
    if solid.shape is Shape.BOX:
        mesh = trimesh.creation.box([2.0 * solid.half_x_m, 2.0 * solid.half_y_m, height_m])
    else:
        mesh = trimesh.creation.cylinder(solid.half_x_m, height=height_m, sections=CYLINDER_SECTIONS)
    T_w_s = trimesh.transformations.rotation_matrix(solid.yaw_rad, [0.0, 0.0, 1.0])
    T_w_s[:3, 3] = solid.x_m, solid.y_m, solid.z0_m + 0.5 * height_m
    return mesh.apply_transform(T_w_s)
