"""Put furniture into a floor plan so that a robot still gets everywhere."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rendezvous.errors import FloorplanError
from rendezvous.floorplan import catalogue as c
from rendezvous.floorplan.catalogue import Maker
from rendezvous.floorplan.records import Floorplan, Piece, Room, Solid
from rendezvous.floorplan.site import CELL_M, Site
from rendezvous.geometry.se2 import Array


@dataclass(frozen=True, slots=True, kw_only=True)
class Recipe:
    """How rooms of a category are furnished."""

    fill: float  # share of the floor that furniture takes at density 1
    first: tuple[Maker, ...]  # pieces typical of the room, tried in this order
    then: tuple[Maker, ...]  # further pieces, drawn uniformly


CLUTTER = (c.boxes, c.plant, c.pole, c.bin_, c.single_chair)

RECIPES = {
    "Bedroom": Recipe(
        fill=0.34, first=(c.bed, c.wardrobe, c.desk), then=(c.drawers, c.shelf, c.armchair, *CLUTTER)
    ),
    "Living_Room": Recipe(
        fill=0.26,
        first=(c.sofa, c.coffee_table, c.dining_table, c.shelf),
        then=(c.sofa, c.armchair, c.shelf, c.drawers, c.radiator, *CLUTTER),
    ),
    "Dining_Room": Recipe(
        fill=0.3, first=(c.dining_table, c.drawers), then=(c.shelf, c.armchair, c.radiator, *CLUTTER)
    ),
    "Kitchen": Recipe(
        fill=0.32, first=(c.counter, c.appliance, c.round_table), then=(c.counter, c.drawers, *CLUTTER)
    ),
    "Bathroom": Recipe(
        fill=0.32, first=(c.bathtub, c.toilet, c.washbasin), then=(c.drawers, c.bin_, c.radiator)
    ),
    "Toilet": Recipe(fill=0.2, first=(c.toilet, c.washbasin), then=(c.bin_, c.radiator)),
    "Office": Recipe(
        fill=0.3,
        first=(c.desk, c.shelf, c.desk),
        then=(c.desk, c.desk, c.drawers, c.rack, c.screen, *CLUTTER),
    ),
    "Meeting_Room": Recipe(
        fill=0.28, first=(c.meeting_table,), then=(c.drawers, c.shelf, c.screen, c.radiator, *CLUTTER)
    ),
    "Storage": Recipe(fill=0.3, first=(c.rack, c.shelf), then=(c.rack, c.boxes, c.boxes, c.shelf, *CLUTTER)),
    "Corridor": Recipe(fill=0.06, first=(), then=(c.bench, c.radiator, c.drawers, c.plant, c.bin_, c.boxes)),
    "Large_Hall": Recipe(
        fill=0.04,
        first=(),
        then=(c.round_table, c.meeting_table, c.boxes, c.rack, c.screen, c.desk, c.bench, *CLUTTER),
    ),
    "Warehouse": Recipe(
        fill=0.2,
        first=(),
        then=(c.pallet, c.pallet, c.pallet, c.stall, c.stall, c.rack, c.desk, c.screen, *CLUTTER),
    ),
    "Hall": Recipe(
        fill=0.14,
        first=(),
        then=(c.round_table, c.meeting_table, c.bench, c.sofa, c.rack, c.screen, c.desk, c.counter, *CLUTTER),
    ),
}
ALIASES = {
    "Child_Room": "Bedroom",
    "Guest_Room": "Bedroom",
    "Lobby": "Hall",
    "Entryway": "Corridor",
    "Hallway": "Corridor",
    "Garage": "Storage",
    "Gym": "Hall",
}
GENERIC = Recipe(
    fill=0.24,
    first=(),
    then=(c.desk, c.sofa, c.dining_table, c.shelf, c.drawers, c.wardrobe, c.armchair, c.rack, *CLUTTER),
)

SMALL_HALL_M2 = 20.0  # a hall under this size is a hallway


def recipe_for(category: str, *, area_m2: float) -> Recipe:
    """The recipe of a HouseExpo category; rooms of unknown use get a mixture."""
    known = ALIASES.get(category, category)
    if known == "Hall" and area_m2 < SMALL_HALL_M2:
        known = "Corridor"
    return RECIPES.get(known, GENERIC)


TRIES = 10  # places tried for one piece
FAILURES = 8  # a room is full when this many pieces in a row find no place
ROUND_M2 = 18.0  # floor per round of a recipe: only large rooms hold the same twice
MIN_AGREEMENT = 0.3  # a label is a room's from this intersection over union on
WALL_SPOT_STEP_M = 0.2


@dataclass(frozen=True, slots=True, kw_only=True)
class Placed:
    """A piece of furniture where it stands."""

    piece: Piece
    pose: Array  # (3,) x [m], y [m], yaw [rad] in w
    item: int  # its number

    def solids(self) -> tuple[Solid, ...]:
        """Its solids in w."""
        return self.piece.placed(self.pose, item=self.item)


def furnish(
    floorplan: Floorplan, rng: np.random.Generator, *, density: float, robot_radius_m: float
) -> tuple[Solid, ...]:
    """Furniture for one episode.

    Solids that start below `DRIVE_UNDER_M` stand on the floor and are at least 0.25 m high, so that the lidar
    sees them; the others are table tops and the like, above the robot. Doorways stay clear. The robot
    still reaches, with clearance, nearly all that it could reach before, and every start region.

    Args:
        floorplan: a validated plan.
        rng: draws pieces and places.
        density: 0 none, 1 moderate, 2 crowded.
        robot_radius_m: radius of the robot that has to get around.

    Returns:
        The solids; those of one piece share `item`, numbered from 0.

    Raises:
        FloorplanError: the density is out of range.
    """
    pieces = arranged(floorplan, rng, density=density, robot_radius_m=robot_radius_m)
    return tuple(solid for placed in pieces for solid in placed.solids())


def arranged(
    floorplan: Floorplan, rng: np.random.Generator, *, density: float, robot_radius_m: float
) -> tuple[Placed, ...]:
    """The furniture of `furnish` as pieces, in the order in which they were placed.

    Raises:
        FloorplanError: the density is out of range.
    """
    if not 0.0 <= density <= 3.0:
        raise FloorplanError(f"furniture density {density}; must be from 0 (none) to 3 (packed)")
    if density == 0.0:
        return ()
    site = Site(floorplan, robot_radius_m=robot_radius_m)
    pieces: list[Placed] = []
    spots = _wall_spots(floorplan, site)
    for cells, room_spots in zip(site.cells_per_room(), spots, strict=True):
        if len(room_spots) and len(cells):
            room = _FloorSpace(site=site, cells=cells, spots=room_spots)
            category = _category(room, floorplan.rooms)
            pieces += _furnished(room, category, rng, density=density, item=len(pieces))
    return tuple(pieces)


class _FloorSpace:
    """One room of a site: a quarter of its cells (N, 2) row, col, and its wall spots (M, 3).

    A wall spot is x [m], y [m] on a wall and the heading of the wall's normal [rad].
    """

    def __init__(self, *, site: Site, cells: NDArray[np.int64], spots: Array) -> None:
        self.site, self.cells, self.spots = site, cells, spots
        self.area_m2 = 4.0 * len(cells) * CELL_M**2


def _furnished(
    room: _FloorSpace, category: str, rng: np.random.Generator, *, density: float, item: int
) -> list[Placed]:
    """Pieces until the floor that they take reaches the room's budget, or no more find a place."""
    recipe = recipe_for(category, area_m2=room.area_m2)
    # Uniform: the rooms of one storey are not equally full.
    budget_m2 = density * recipe.fill * room.area_m2 * rng.uniform(0.6, 1.4)
    pieces: list[Placed] = []
    failures = 0
    for make in _queue(recipe, rng, rounds=1 + int(density * room.area_m2 / ROUND_M2)):
        piece = make(rng)
        area_m2 = 4.0 * piece.half_x_m * piece.half_y_m
        if area_m2 > 1.5 * budget_m2:
            continue
        poses = _wall_poses(piece, room.spots, rng) if piece.at_wall else _free_poses(room, rng)
        pose = room.site.place_in_place(piece, poses)
        failures = 0 if pose is not None else failures + 1
        if failures == FAILURES:
            break
        if pose is not None:
            pieces.append(Placed(piece=piece, pose=pose, item=item + len(pieces)))
            budget_m2 -= area_m2
    return pieces


def _queue(recipe: Recipe, rng: np.random.Generator, *, rounds: int) -> Iterator[Maker]:
    """The pieces typical of the room, then the others in random order, each once per round."""
    yield from recipe.first
    for _ in range(rounds):
        for i in rng.permutation(len(recipe.then)):
            yield recipe.then[i]


def _wall_poses(piece: Piece, spots: Array, rng: np.random.Generator) -> Array:
    """(T, 3) x [m], y [m], yaw [rad]: back to a wall."""
    x_m, y_m, normal_rad = spots[rng.integers(len(spots), size=TRIES)].T
    # The gap is uniform, the turn normal with 0.6 degrees: nobody aligns a cupboard better.
    away_m = piece.half_y_m + rng.uniform(0.01, 0.08, size=TRIES)
    yaw_rad = normal_rad - 0.5 * math.pi + rng.normal(0.0, 0.01, size=TRIES)
    return np.column_stack([x_m + away_m * np.cos(normal_rad), y_m + away_m * np.sin(normal_rad), yaw_rad])


def _free_poses(room: _FloorSpace, rng: np.random.Generator) -> Array:
    """(T, 3) x [m], y [m], yaw [rad]: anywhere, four in five about square to a wall."""
    row_col = room.cells[rng.integers(len(room.cells), size=TRIES)]
    xy_m = room.site.origin_m + CELL_M * (row_col[:, ::-1] + 2.0 * rng.random((TRIES, 2)))
    normal_rad = room.spots[rng.integers(len(room.spots), size=TRIES), 2]
    square_rad = normal_rad + 0.5 * math.pi * rng.integers(4, size=TRIES) + rng.normal(0.0, 0.06, size=TRIES)
    any_rad = rng.uniform(-math.pi, math.pi, size=TRIES)
    return np.column_stack([xy_m, np.where(rng.random(TRIES) < 0.8, square_rad, any_rad)])


def _wall_spots(floorplan: Floorplan, site: Site) -> list[Array]:
    """Per room (M, 3): points along its walls and the heading away from the wall."""
    edges_m = floorplan.edges_m()
    step_m = edges_m[:, 2:] - edges_m[:, :2]
    length_m = np.linalg.norm(step_m, axis=1)
    count = np.floor(length_m / WALL_SPOT_STEP_M).astype(int)
    edge = np.repeat(np.arange(len(edges_m)), count)
    # Free space lies to the left of every edge.
    normal_rad = np.arctan2(step_m[edge, 0], -step_m[edge, 1])
    within = np.arange(len(edge)) - np.repeat(np.cumsum(count) - count, count)
    p_m = edges_m[edge, :2] + step_m[edge] * ((within + 0.5) / count[edge])[:, None]
    rooms = site.room_at(p_m + 3.0 * CELL_M * np.stack([np.cos(normal_rad), np.sin(normal_rad)], axis=1))
    spots = np.column_stack([p_m, normal_rad])
    return [spots[rooms == room] for room in range(1, site.room_count + 1)]


def _category(room: _FloorSpace, labels: tuple[Room, ...]) -> str:
    """The label whose box agrees best with the room's, by intersection over union; none if all are poor."""
    if not labels:
        return ""
    boxes_m = np.array([label.box_m for label in labels])
    # Quantiles: some cells in the doorways are nearer to the next room.
    low_m, high_m = np.quantile(room.site.origin_m + CELL_M * room.cells[:, ::-1], [0.02, 0.98], axis=0)
    shared_m = np.minimum(boxes_m[:, 2:], high_m) - np.maximum(boxes_m[:, :2], low_m)
    shared_m2 = np.prod(np.maximum(shared_m, 0.0), axis=1)
    box_m2 = np.prod(boxes_m[:, 2:] - boxes_m[:, :2], axis=1)
    agreement = shared_m2 / (box_m2 + np.prod(high_m - low_m) - shared_m2)
    best = int(np.argmax(agreement))
    return labels[best].category if agreement[best] > MIN_AGREEMENT else ""
