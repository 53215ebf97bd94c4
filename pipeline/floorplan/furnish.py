"""Put furniture into a floor plan so that a robot still gets everywhere."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from pipeline.errors import FloorplanError
from pipeline.floorplan.catalogue import Maker, Piece
from pipeline.floorplan.recipes import Recipe, recipe_for
from pipeline.floorplan.records import Floorplan, Room, Solid
from pipeline.floorplan.site import CELL_M, Site
from pipeline.geometry.se2 import Array

TRIES = 10
"""Places tried for one piece."""

FAILURES = 4
"""A room is full when this many pieces in a row find no place."""

WALL_SPOT_STEP_M = 0.2


def furnish(floorplan: Floorplan, rng: np.random.Generator, *, density: float) -> tuple[Solid, ...]:
    """Furniture for one episode.

    Solids that start below `DRIVE_UNDER_M` stand on the floor and are at least 0.25 m high, so that the lidar
    sees them; the others are table tops and the like, above the robot. Doorways stay clear. A robot of radius
    0.105 m still reaches, with clearance, nearly all that it could reach before, and every start region.

    Args:
        floorplan: a validated plan.
        rng: draws pieces and places.
        density: 0 none, 1 moderate, 2 crowded.

    Returns:
        The solids; those of one piece share `item`, numbered from 0.

    Raises:
        FloorplanError: the density is out of range.
    """
    if not 0.0 <= density <= 3.0:
        raise FloorplanError(f"furniture density {density}; must be from 0 (none) to 3 (packed)")
    if density == 0.0:
        return ()
    site = Site(floorplan)
    solids: list[Solid] = []
    spots = _wall_spots(floorplan, site)
    for cells, room_spots in zip(site.cells_per_room(), spots, strict=True):
        if len(room_spots) and len(cells):
            item = solids[-1].item + 1 if solids else 0
            room = _FloorSpace(site=site, cells=cells, spots=room_spots)
            solids += _furnished(room, _category(room, floorplan.rooms), rng, density=density, item=item)
    return tuple(solids)


class _FloorSpace:
    """One room of a site: its cells (N, 2) row, col and wall spots (M, 3) x [m], y [m], normal [rad]."""

    def __init__(self, *, site: Site, cells: NDArray[np.int64], spots: Array) -> None:
        self.site, self.cells, self.spots = site, cells, spots
        self.area_m2 = len(cells) * CELL_M**2


def _furnished(
    room: _FloorSpace, category: str, rng: np.random.Generator, *, density: float, item: int
) -> list[Solid]:
    """Pieces until the floor that they take reaches the room's budget, or no more find a place."""
    recipe = recipe_for(category, area_m2=room.area_m2)
    # Uniform: the rooms of one storey are not equally full.
    budget_m2 = density * recipe.fill * room.area_m2 * rng.uniform(0.5, 1.4)
    solids: list[Solid] = []
    queue, failures = list(recipe.first), 0
    while budget_m2 > 0.0 and failures < FAILURES:
        piece = _next_piece(recipe, queue, rng)
        area_m2 = 4.0 * piece.half_x_m * piece.half_y_m
        placed = _placed(piece, room, rng, item) if area_m2 < 1.5 * budget_m2 else ()
        if placed:
            solids += placed
            budget_m2 -= area_m2
            item += 1
        failures = 0 if placed else failures + 1
    return solids


def _next_piece(recipe: Recipe, queue: list[Maker], rng: np.random.Generator) -> Piece:
    make = queue.pop(0) if queue else recipe.then[int(rng.integers(len(recipe.then)))]
    return make(rng)


def _placed(piece: Piece, room: _FloorSpace, rng: np.random.Generator, item: int) -> tuple[Solid, ...]:
    """The piece's solids where it fits, or none after `TRIES` places that do not do."""
    poses = _wall_poses(piece, room.spots, rng) if piece.at_wall else _free_poses(room, rng)
    footprints_m = _rectangles(poses, piece.half_x_m, piece.half_y_m)
    inside = room.site.inside(footprints_m)
    for (x_m, y_m, yaw_rad), footprint_m in zip(poses[inside].tolist(), footprints_m[inside], strict=True):
        if room.site.is_vacant(footprint_m):
            solids = piece.placed(x_m, y_m, yaw_rad, item=item)
            if room.site.admit_in_place(solids, footprint_m):
                return solids
    return ()


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
    xy_m = room.site.origin_m + CELL_M * (row_col[:, ::-1] + rng.random((TRIES, 2)))
    normal_rad = room.spots[rng.integers(len(room.spots), size=TRIES), 2]
    square_rad = normal_rad + 0.5 * math.pi * rng.integers(4, size=TRIES) + rng.normal(0.0, 0.06, size=TRIES)
    any_rad = rng.uniform(-math.pi, math.pi, size=TRIES)
    return np.column_stack([xy_m, np.where(rng.random(TRIES) < 0.8, square_rad, any_rad)])


def _rectangles(poses: Array, half_x_m: float, half_y_m: float) -> Array:
    """(T, 4, 2) [m] corners of rectangles at poses (T, 3)."""
    corners_m = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]]) * (half_x_m, half_y_m)
    cos, sin = np.cos(poses[:, 2:]), np.sin(poses[:, 2:])
    x_m = poses[:, 0:1] + cos * corners_m[:, 0] - sin * corners_m[:, 1]
    y_m = poses[:, 1:2] + sin * corners_m[:, 0] + cos * corners_m[:, 1]
    return np.stack([x_m, y_m], axis=2)


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
    """The label whose box covers most of the room; of several that do about equally, the smallest box."""
    if not labels:
        return ""
    # Every 16th cell tells enough.
    p_m = room.site.origin_m + CELL_M * (room.cells[::16, ::-1] + 0.5)
    boxes_m = np.array([label.box_m for label in labels])
    covered = (p_m[:, None] >= boxes_m[:, :2]) & (p_m[:, None] <= boxes_m[:, 2:])
    share = covered.all(axis=2).mean(axis=0)
    area_m2 = np.prod(boxes_m[:, 2:] - boxes_m[:, :2], axis=1)
    best = int(np.argmax(share - 1e-3 * area_m2))
    return labels[best].category if share[best] > 0.5 else ""
