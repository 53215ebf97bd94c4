"""What a furnished plan looks like: materials for its surfaces, and leaves for its plants."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from rendezvous.floorplan.records import Solid
from rendezvous.rendering.appearance import materials
from rendezvous.rendering.plan_scene import MaterialOf, plan_instances
from rendezvous.rendering.scene import Instance, Material
from rendezvous.rendering.viewpoints import FurnishedPlan

ACCENT_SHARE = 1.0 / 7.0
"""Share of walls that differ from the others."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RoomLooks:
    """Materials of a furnished plan: drawn once per episode, so that its pictures agree.

    Attributes:
        floor, ceiling, wall, accent: their materials.
        accent_faces: indices of walls that are of the accent's.
        pieces: by index of the piece of furniture: its body's, and that of legs, leaves or headboard.
    """

    floor: Material
    ceiling: Material
    wall: Material
    accent: Material
    accent_faces: tuple[int, ...]
    pieces: Mapping[int, tuple[Material, Material]]

    def material_of(self, furniture: Sequence[Solid]) -> MaterialOf:
        """As `plan_instances` asks for it."""
        faces = frozenset(self.accent_faces)

        def of(category: str, part: int) -> Material:
            if category in ("floor", "ceiling"):
                return self.floor if category == "floor" else self.ceiling
            if category == "wall":
                return self.accent if part in faces else self.wall
            solid = furniture[part]
            return self.pieces[solid.item][materials.is_second(solid)]

        return of


def draw_room_looks(rng: np.random.Generator, place: FurnishedPlan, *, variants: int) -> RoomLooks:
    """One material for most walls and another for one in seven; furniture by what it is.

    Args:
        rng: draws the materials.
        place: the furnished plan.
        variants: textures of each kind in the pool.
    """
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
    """Floor, ceiling, walls and furniture."""
    instances = plan_instances(
        place.plan,
        place.furniture,
        wall_height_m=place.wall_height_m,
        material_of=looks.material_of(place.furniture),
    )
    first = len(instances) - len(place.furniture)
    pot_tops_m = {s.item: s.z1_m for s in place.furniture if s.category == "plant" and s.z0_m == 0.0}
    planted = [
        _leaves(instance, solid, pot_tops_m[solid.item]) if _grows(solid) else instance
        for instance, solid in zip(instances[first:], place.furniture, strict=True)
    ]
    return [*instances[:first], *planted]


def _grows(solid: Solid) -> bool:
    """Physics has a plant's leaves as a cylinder above its pot."""
    return solid.category == "plant" and solid.z0_m > 0.0


def _leaves(instance: Instance, solid: Solid, pot_top_m: float) -> Instance:
    """Leaves that fill that cylinder and grow out of the pot."""
    T_w = instance.T_w.copy()
    T_w[2, 2] = (solid.z1_m - pot_top_m) / 0.88
    T_w[2, 3] = pot_top_m
    return replace(instance, mesh="thing/leaves", T_w=T_w)
