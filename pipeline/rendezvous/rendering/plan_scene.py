"""A furnished floor plan as instances of four meshes of unit size: no plan needs meshes of its own."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import trimesh

from rendezvous.floorplan.records import Floorplan, Shape, Solid
from rendezvous.floorplan.walls import wall_boxes
from rendezvous.geometry.camera import se3_from_se2
from rendezvous.rendering.scene import Instance, Material, MeshPool

BOX, CYLINDER, QUAD, WALL = "box", "cylinder", "quad", "wall"
CYLINDER_SECTIONS = 32
MARGIN_M = 1.0

MaterialOf = Callable[[str, int], Material]
"""Material of a category ("floor", "ceiling", "wall", "table", ...) and a part of it.

The part is, for a wall, the number of its face; for furniture, the index of the solid; else 0.
"""


def plan_meshes() -> MeshPool:
    """Box, cylinder, upward quad and wall with sides of 1 m around the origin.

    Without UVs: the renderer papers them along their axes, at a scale that stretching does not change.
    """
    return {BOX: (_unit_box(),), CYLINDER: (_unit_cylinder(),), QUAD: (_unit_quad(),), WALL: (_unit_wall(),)}


def plan_instances(
    floorplan: Floorplan, furniture: Sequence[Solid], *, wall_height_m: float, material_of: MaterialOf
) -> tuple[Instance, ...]:
    """Floor, ceiling, walls and furniture of a plan.

    The ceiling shows from below only and lets light through from above.
    """
    walls = wall_boxes(floorplan, height_m=wall_height_m)
    return (
        _level("floor", floorplan, 0.0, material_of("floor", 0), facing=1.0),
        _level("ceiling", floorplan, wall_height_m, material_of("ceiling", 0), facing=-1.0),
        *(
            replace(solid_instance(wall, name=f"wall/{i:04d}", material=material_of("wall", i)), mesh=WALL)
            for i, wall in enumerate(walls)
        ),
        *(
            solid_instance(
                solid,
                name=f"{solid.item:03d}-{solid.category}/{i:04d}",
                material=material_of(solid.category, i),
            )
            for i, solid in enumerate(furniture)
        ),
    )


def solid_instance(solid: Solid, *, name: str, material: Material) -> Instance:
    """A wall box or a part of a piece of furniture."""
    T_w = se3_from_se2(solid.T_w_s())
    T_w[2, 3] = 0.5 * (solid.z0_m + solid.z1_m)
    T_w[:3, :3] *= (2.0 * solid.half_x_m, 2.0 * solid.half_y_m, solid.z1_m - solid.z0_m)
    mesh = BOX if solid.shape is Shape.BOX else CYLINDER
    return Instance(name=name, mesh=mesh, T_w=T_w, material=material)


def _level(name: str, floorplan: Floorplan, z_m: float, material: Material, *, facing: float) -> Instance:
    """A quad under or over the whole plan; walls hide what of it lies outside."""
    low = floorplan.outline_m.min(axis=0) - MARGIN_M
    high = floorplan.outline_m.max(axis=0) + MARGIN_M
    size_x_m, size_y_m = high - low
    # Turned about x to face down, so that it stays a rotation.
    T_w = np.diag([size_x_m, facing * size_y_m, facing, 1.0])
    T_w[:3, 3] = *(0.5 * (low + high)), z_m
    return Instance(name=name, mesh=QUAD, T_w=T_w, material=material)


def _unit_quad() -> trimesh.Trimesh:
    corners = [[-0.5, -0.5, 0.0], [0.5, -0.5, 0.0], [0.5, 0.5, 0.0], [-0.5, 0.5, 0.0]]
    return trimesh.Trimesh(vertices=corners, faces=[[0, 1, 2], [0, 2, 3]], process=False)


def _unit_box() -> trimesh.Trimesh:
    box = trimesh.creation.box([1.0, 1.0, 1.0])
    box.unmerge_vertices()  # sharp edges: each face with normals of its own
    return box


def _unit_wall() -> trimesh.Trimesh:
    """A box whose sides and back shrink away from its front, +y, where the free space is.

    The ends of a wall's box lie in the faces of its neighbours, its back may lie in the face beyond: where
    two surfaces share a plane, both would show in stripes.
    """
    x, y = np.array([-0.5, 0.5, 0.45, -0.45]), np.array([0.5, 0.5, -0.4, -0.4])
    corners = np.concatenate([np.column_stack([x, y, np.full(4, z)]) for z in (-0.5, 0.5)])
    wall = trimesh.Trimesh(vertices=corners, process=False).convex_hull
    wall.unmerge_vertices()
    return wall


def _unit_cylinder() -> trimesh.Trimesh:
    """Of diameter 1 m and height 1 m, smooth around, with flat ends."""
    cylinder = trimesh.creation.cylinder(0.5, height=1.0, sections=CYLINDER_SECTIONS)
    return trimesh.graph.smooth_shade(cylinder, angle=np.radians(30.0))
