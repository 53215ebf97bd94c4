"""A furnished floor plan as instances of four unit meshes, and the materials that it is made of."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import trimesh

from rendezvous.floorplan.records import Floorplan, Shape, Solid
from rendezvous.floorplan.walls import wall_boxes
from rendezvous.geometry.camera import se3_from_se2
from rendezvous.rendering.appearance import materials
from rendezvous.rendering.scene import Instance, Material, MeshPool
from rendezvous.rendering.viewpoints import FurnishedPlan

BOX, CYLINDER, QUAD, WALL = "box", "cylinder", "quad", "wall"
CYLINDER_SECTIONS = 32
MARGIN_M = 1.0
ACCENT_SHARE = 1.0 / 7.0  # share of walls that differ from the others
LEAVES_HEIGHT = 0.88  # height of the unit mesh of leaves

MaterialOf = Callable[[str, int], Material]
"""Material of a part of a category ("floor", "ceiling", "wall", "table", ...).

The part is the face's number for a wall, the solid's index for furniture, and 0 otherwise.
"""


def plan_meshes() -> MeshPool:
    """Box, cylinder, upward quad and wall with sides of 1 m about the origin, without UVs."""
    return {BOX: (_unit_box(),), CYLINDER: (_unit_cylinder(),), QUAD: (_unit_quad(),), WALL: (_unit_wall(),)}


def plan_instances(
    floorplan: Floorplan, furniture: Sequence[Solid], *, wall_height_m: float, material_of: MaterialOf
) -> tuple[Instance, ...]:
    """Floor, ceiling, walls and furniture; from above, the ceiling is invisible and lets light in."""
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
    """A quad below or above the whole plan; walls hide the part outside."""
    low = floorplan.outline_m.min(axis=0) - MARGIN_M
    high = floorplan.outline_m.max(axis=0) + MARGIN_M
    size_x_m, size_y_m = high - low
    # To face down it is turned about x, which keeps it a rotation.
    T_w = np.diag([size_x_m, facing * size_y_m, facing, 1.0])
    T_w[:3, 3] = *(0.5 * (low + high)), z_m
    return Instance(name=name, mesh=QUAD, T_w=T_w, material=material)


def _unit_quad() -> trimesh.Trimesh:
    corners = [[-0.5, -0.5, 0.0], [0.5, -0.5, 0.0], [0.5, 0.5, 0.0], [-0.5, 0.5, 0.0]]
    return trimesh.Trimesh(vertices=corners, faces=[[0, 1, 2], [0, 2, 3]], process=False)


def _unit_box() -> trimesh.Trimesh:
    box = trimesh.creation.box([1.0, 1.0, 1.0])
    box.unmerge_vertices()  # separate normals for each face: sharp edges
    return box


def _unit_wall() -> trimesh.Trimesh:
    """A box that tapers from its front, +y, where the free space is.

    The ends of a wall's box lie in the faces of its neighbours, and its back may lie in the face behind;
    surfaces in one plane would show as stripes.
    """
    x, y = np.array([-0.5, 0.5, 0.45, -0.45]), np.array([0.5, 0.5, -0.4, -0.4])
    corners = np.concatenate([np.column_stack([x, y, np.full(4, z)]) for z in (-0.5, 0.5)])
    wall = trimesh.Trimesh(vertices=corners, process=False).convex_hull
    wall.unmerge_vertices()
    return wall


def _unit_cylinder() -> trimesh.Trimesh:
    """A cylinder of diameter and height 1 m with smooth sides and flat ends."""
    cylinder = trimesh.creation.cylinder(0.5, height=1.0, sections=CYLINDER_SECTIONS)
    return trimesh.graph.smooth_shade(cylinder, angle=np.radians(30.0))


@dataclass(frozen=True, slots=True, kw_only=True)
class RoomLooks:
    """Materials of a furnished plan, drawn once per episode so that its pictures agree."""

    # floor, ceiling, wall, accent: their materials.
    floor: Material
    ceiling: Material
    wall: Material
    accent: Material
    accent_faces: tuple[int, ...]  # indices of the walls with the accent's material
    # Materials of each piece of furniture, by its index; see `materials.piece_materials`.
    pieces: Mapping[int, tuple[Material, Material]]

    def material_of(self, furniture: Sequence[Solid]) -> MaterialOf:
        """The materials as `plan_instances` takes them."""

        def of(category: str, part: int) -> Material:
            match category:
                case "floor":
                    return self.floor
                case "ceiling":
                    return self.ceiling
                case "wall":
                    return self.accent if part in self.accent_faces else self.wall
            return self.pieces[furniture[part].item][materials.is_second(furniture[part])]

        return of


def draw_room_looks(rng: np.random.Generator, place: FurnishedPlan, *, variants: int) -> RoomLooks:
    """One material for most walls and another for one in seven; furniture by its category."""
    accents = np.flatnonzero(rng.random(len(place.plan.edges_m())) < ACCENT_SHARE)
    return RoomLooks(
        floor=materials.floor_material(rng, variants),
        ceiling=materials.ceiling_material(rng, variants),
        wall=materials.wall_material(rng, variants),
        accent=materials.wall_material(rng, variants),
        accent_faces=tuple(accents.tolist()),
        pieces=materials.piece_materials(rng, place.furniture, variants=variants),
    )


def room_instances(place: FurnishedPlan, looks: RoomLooks) -> list[Instance]:
    """Floor, ceiling, walls and furniture in these materials, plants with leaves."""
    instances = plan_instances(
        place.plan,
        place.furniture,
        wall_height_m=place.wall_height_m,
        material_of=looks.material_of(place.furniture),
    )
    first = len(instances) - len(place.furniture)
    pot_tops_m = {s.item: s.z1_m for s in place.furniture if s.category == "plant" and s.z0_m == 0.0}
    planted = list(instances)
    for i, solid in enumerate(place.furniture, start=first):
        # In physics, a plant's leaves are a cylinder above its pot; here they also grow out of it.
        if solid.category == "plant" and solid.z0_m > 0.0:
            T_w = instances[i].T_w.copy()
            T_w[2, 2] = (solid.z1_m - pot_tops_m[solid.item]) / LEAVES_HEIGHT
            T_w[2, 3] = pot_tops_m[solid.item]
            planted[i] = replace(instances[i], mesh="thing/leaves", T_w=T_w)
    return planted
