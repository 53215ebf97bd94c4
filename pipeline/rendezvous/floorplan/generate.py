"""Generate floor plans: apartments, offices with corridors, larger halls."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import cycle

import numpy as np
import shapely
from shapely import LineString, Polygon

from rendezvous.errors import FloorplanError
from rendezvous.floorplan.large_hall import large_hall, warehouse
from rendezvous.floorplan.layouts import Storey, apartment, hall, office, tapered
from rendezvous.floorplan.partition import Walls, is_compact, shared_walls
from rendezvous.floorplan.records import Floorplan, Room
from rendezvous.floorplan.validate import FloorplanLimits, validated
from rendezvous.geometry.se2 import Array
from rendezvous.seeds import stream

LAYOUTS = {
    "apartment": apartment,
    "office": office,
    "hall": hall,
    "large_hall": large_hall,
    "warehouse": warehouse,
}
LATER_KINDS = ("large_hall", "warehouse")  # plans of earlier versions are as if these had weight 0
ATTEMPTS = 50  # layouts drawn before giving up; a few per cent of them fail
SHIPPED_KINDS = ("apartment", "office", "apartment", "hall", "office", "apartment")

ALL_REACHABLE = FloorplanLimits(min_reachable_share=0.97)  # no generated room may be shut


@dataclass(frozen=True, slots=True, kw_only=True)
class GeneratorParameters:
    """The distributions that plans are drawn from; ranges are (least, most)."""

    # apartment, office, hall, large_hall, warehouse: weights of the kinds.
    apartment: float = 0.45
    office: float = 0.35
    hall: float = 0.2
    large_hall: float = 0.0
    warehouse: float = 0.0
    rooms: tuple[int, int] = (3, 20)  # number of rooms, corridors included
    # Thickness of partition walls; single walls are thicker, up to the end of the range.
    wall_thickness_m: tuple[float, float] = (0.08, 0.3)
    door_width_m: tuple[float, float] = (0.7, 1.2)  # clear width of doors; archways are wider
    slanted_share: float = 0.4  # share of plans with slanted walls
    loop_share: float = 0.25  # probability of a door beyond those that connect all rooms, per two neighbours
    niche_share: float = 0.35  # probability of a pilaster, shaft or window bay, per room

    def __post_init__(self) -> None:
        weights = self.weights()
        if min(weights.values()) < 0 or sum(weights.values()) <= 0:
            given = ", ".join(f"{kind} {weight}" for kind, weight in weights.items())
            raise FloorplanError(f"generator: weights {given}; must not be negative, nor all zero")
        for name, low, high in (
            ("rooms", 3, 20),
            ("wall_thickness_m", 0.05, 0.4),
            ("door_width_m", 0.6, 1.4),
        ):
            least, most = getattr(self, name)
            if not low <= least <= most <= high:
                raise FloorplanError(
                    f"generator: {name} is ({least}, {most}); must be (least, most) within {low} to {high}"
                )

    def weights(self) -> dict[str, float]:
        """The weight of each kind, oldest first: a newer one of weight 0 changes no draw."""
        return {kind: getattr(self, kind) for kind in LAYOUTS}


def generate_floorplan(
    rng: np.random.Generator,
    *,
    plan_id: str,
    robot_radius_m: float,
    parameters: GeneratorParameters | None = None,
) -> Floorplan:
    """A valid floor plan.

    Raises:
        FloorplanError: no valid plan in `ATTEMPTS` layouts; the parameters contradict each other.
    """
    drawn_from = parameters or GeneratorParameters()
    weights = np.array(list(drawn_from.weights().values()))
    # Categorical over the kinds.
    kind = list(LAYOUTS)[rng.choice(len(weights), p=weights / weights.sum())]
    reason = ""
    for _ in range(ATTEMPTS):
        slanted = rng.random() < drawn_from.slanted_share
        layout = LAYOUTS[kind](rng, slanted=slanted)
        if slanted and rng.random() < 0.4:
            layout = tapered(layout, rng)
        if not drawn_from.rooms[0] <= len(layout.cells) <= drawn_from.rooms[1]:
            reason = f"{len(layout.cells)} rooms"
            continue
        if _wraps(layout):
            reason = "a room wraps around another"
            continue
        try:
            built = _built(layout, rng, plan_id, drawn_from)
            return validated(built, robot_radius_m=robot_radius_m, limits=ALL_REACHABLE)
        except FloorplanError as error:
            reason = str(error)
    raise FloorplanError(f"{plan_id}: no valid plan in {ATTEMPTS} attempts, the last one: {reason}")


def shipped_floorplans(count: int, *, robot_radius_m: float, seed: int = 0) -> list[Floorplan]:
    """The plans of the folder `floorplans/`: `rdv-000`, `rdv-001`, ..., kinds by turns."""
    plans = []
    for plan_id, kind in zip((f"rdv-{i:03d}" for i in range(count)), cycle(SHIPPED_KINDS), strict=False):
        only = GeneratorParameters(
            apartment=float(kind == "apartment"), office=float(kind == "office"), hall=float(kind == "hall")
        )
        rng = stream(seed, "shipped", plan_id)
        plans.append(generate_floorplan(rng, plan_id=plan_id, robot_radius_m=robot_radius_m, parameters=only))
    return plans


def _wraps(layout: Storey) -> bool:
    """Whether a room is wrapped around the hub or around several others."""
    hub = layout.cells[layout.hub]
    others = [cell for i, cell in enumerate(layout.cells) if i != layout.hub]
    return any(
        not is_compact(cell) or cell.convex_hull.intersection(hub).area > 0.5 * hub.area for cell in others
    )


def _built(
    layout: Storey, rng: np.random.Generator, plan_id: str, parameters: GeneratorParameters
) -> Floorplan:
    """The layout with walls of some thickness, doors, niches and posts."""
    # Most partition walls are thin: a beta distribution that leans to the low end of the range.
    least_m, most_m = parameters.wall_thickness_m
    wall_m = least_m + (most_m - least_m) * rng.beta(1.3, 3.0)
    rooms = [cell.buffer(-0.5 * wall_m, join_style="mitre") for cell in layout.cells]
    if not all(isinstance(room, Polygon) and not room.is_empty for room in rooms):
        raise FloorplanError(f"{plan_id}: a room falls apart between walls of {wall_m:.2f} m")
    walls = shared_walls(layout.cells)
    solids = [*layout.posts, *_thick_walls(list(walls.values()), rng, wall_m, most_m)]
    doors = _connected(layout, walls, rng, parameters)
    openings = [_opening(walls[door], rng, layout, door, parameters) for door in doors]
    doorways = shapely.union_all([opening.buffer(0.45, quad_segs=2) for opening in openings])
    solids += [s for s in _niches(rooms, rng, parameters.niche_share) if not s.intersects(doorways)]
    free = shapely.union_all(rooms).difference(shapely.union_all(solids))
    free = shapely.union_all([free, *openings])
    if not isinstance(free, Polygon):
        raise FloorplanError(f"{plan_id}: {len(shapely.get_parts(free))} pieces of free space")
    x0, y0 = free.bounds[:2]
    corner = np.round([x0, y0], 3)
    return Floorplan(
        plan_id=plan_id,
        outline_m=np.asarray(free.exterior.coords[:-1]) - corner,
        holes_m=tuple(np.asarray(ring.coords[:-1]) - corner for ring in free.interiors),
        rooms=tuple(
            Room(category=category, box_m=_box(room, corner))
            for category, room in zip(layout.categories, rooms, strict=True)
        ),
    )


def _box(room: Polygon, corner_m: Array) -> tuple[float, float, float, float]:
    # Adding 0 turns -0.0 into 0.0.
    box_m = np.round(np.array(room.bounds) - np.tile(corner_m, 2), 3) + 0.0
    x0, y0, x1, y1 = box_m.tolist()
    return x0, y0, x1, y1


def _connected(
    layout: Storey, walls: Walls, rng: np.random.Generator, parameters: GeneratorParameters
) -> list[tuple[int, int]]:
    """Pairs of rooms with a door: a tree grown from the hub, then some more that close loops.

    A room opens to the hub if it has a wall with it, otherwise to a room that is already connected.
    """
    fits_m = parameters.door_width_m[0] + 2.0 * parameters.wall_thickness_m[1]
    long_enough = [pair for pair, wall_m in walls.items() if np.linalg.norm(wall_m[1] - wall_m[0]) > fits_m]
    reached, doors = {layout.hub}, []
    while True:
        frontier = [pair for pair in long_enough if len(reached & set(pair)) == 1]
        if not frontier:
            break
        to_hub = [pair for pair in frontier if layout.hub in pair]
        pool = to_hub or frontier
        pair = pool[int(rng.integers(len(pool)))]
        doors.append(pair)
        reached |= set(pair)
    extra = [pair for pair in long_enough if pair not in doors and rng.random() < parameters.loop_share]
    return doors + extra


def _opening(
    wall_m: Array,
    rng: np.random.Generator,
    layout: Storey,
    pair: tuple[int, int],
    parameters: GeneratorParameters,
) -> Polygon:
    """A door through a wall; between halls and living rooms sometimes an archway."""
    length_m = float(np.linalg.norm(wall_m[1] - wall_m[0]))
    margin_m = 0.5 * parameters.wall_thickness_m[1] + 0.06
    room_m = length_m - 2.0 * margin_m
    # Uniform widths.
    width_m = min(rng.uniform(*parameters.door_width_m), room_m)
    wide = {"Living_Room", "Dining_Room", "Hall", "Kitchen"}
    if {layout.categories[i] for i in pair} <= wide and room_m > 1.5 and rng.random() < 0.5:
        width_m = rng.uniform(1.4, min(2.2, room_m))
    # Half of the doors are near a corner, the others anywhere along the wall.
    slack_m = room_m - width_m
    shift_m = slack_m * (rng.choice([0.0, 1.0]) if rng.random() < 0.5 else rng.random())
    along = (wall_m[1] - wall_m[0]) / length_m
    start = wall_m[0] + along * (margin_m + shift_m)
    # Deep enough to pierce the thickest wall.
    half_m = 0.5 * parameters.wall_thickness_m[1] + 0.01
    return LineString([start, start + along * width_m]).buffer(half_m, cap_style="flat")


def _thick_walls(
    walls_m: list[Array], rng: np.random.Generator, wall_m: float, most_m: float
) -> list[Polygon]:
    """One wall in five bears more: up to twice as thick."""
    return [
        LineString(ends_m).buffer(0.5 * min(wall_m * rng.uniform(1.3, 2.0), most_m), cap_style="flat")
        for ends_m in walls_m
        if rng.random() < 0.2
    ]


def _niches(rooms: list[Polygon], rng: np.random.Generator, share: float) -> list[Polygon]:
    """Pilasters and shafts: boxes that stand in from a wall or a corner, square to it."""
    niches = []
    for room in rooms:
        if room.area < 5.0 or rng.random() >= share:
            continue
        ring_m = np.asarray(room.exterior.coords)
        edge = int(rng.integers(len(ring_m) - 1))
        start, step = ring_m[edge], ring_m[edge + 1] - ring_m[edge]
        length_m = float(np.linalg.norm(step))
        # Uniform: a shaft in a corner is 0.3 to 0.7 m wide, a pilaster 0.2 to 0.5 m; both stand out less.
        in_corner = rng.random() < 0.5
        width_m = min(rng.uniform(0.3, 0.7) if in_corner else rng.uniform(0.2, 0.5), 0.3 * length_m)
        depth_m = width_m * rng.uniform(0.4, 0.9)
        at_m = 0.0 if in_corner else rng.uniform(0.0, length_m - width_m)
        a = start + step / length_m * at_m
        b = a + step / length_m * width_m
        niches.append(LineString([a, b]).buffer(depth_m, cap_style="flat"))
    return niches
