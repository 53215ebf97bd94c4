"""Cut a building's footprint into rooms and find the walls they share."""

from __future__ import annotations

import math
from itertools import combinations

import numpy as np
import shapely
import shapely.ops
from shapely import LineString, Polygon, box

from rendezvous.geometry.se2 import Array

Walls = dict[tuple[int, int], Array]  # (2, 2) end points [m] by pair of cells

COLLINEAR_M = 1e-6  # two edges closer than this lie on one wall


def footprint(rng: np.random.Generator, *, width_m: float, depth_m: float, slanted: bool) -> Polygon:
    """The outline of a storey: a rectangle, an L, a T or a U; slanted: with a cut corner or side."""
    shell = box(0.0, 0.0, width_m, depth_m)
    # Categorical over the forms, rectangles being the most common.
    form = rng.choice(["rectangle", "L", "T", "U"], p=[0.45, 0.3, 0.15, 0.1])
    for bite in _bites(rng, str(form), width_m, depth_m):
        shell = shell.difference(bite)
    return _slanted(shell, rng) if slanted else shell


def subdivided(
    cells: list[Polygon], rng: np.random.Generator, *, room_area_m2: float, min_side_m: float, slant: float
) -> list[Polygon]:
    """Rooms of about this area that tile the cells, by recursive cuts across their longer sides.

    No room is narrower than `min_side_m`; `slant` is the probability that a cut is tilted.
    """
    rooms: list[Polygon] = []
    for cell in cells:
        parts = _parted(cell, rng, room_area_m2, min_side_m, slant)
        rooms += (
            subdivided(parts, rng, room_area_m2=room_area_m2, min_side_m=min_side_m, slant=slant)
            if parts
            else [cell]
        )
    return rooms


def _parted(
    cell: Polygon, rng: np.random.Generator, room_area_m2: float, min_side_m: float, slant: float
) -> list[Polygon]:
    """The two parts of a cell; none if it is left whole."""
    # Uniform in [0.7, 1.5] of the wanted area, so that sizes differ within one storey.
    if cell.area < room_area_m2 * rng.uniform(0.7, 1.5) and is_compact(cell):
        return []
    for _ in range(6):
        parts = _cut(cell, rng, tilted=rng.random() < slant)
        if len(parts) == 2 and all(_is_roomy(part, min_side_m) for part in parts):
            return parts
    return []


def shared_walls(cells: list[Polygon]) -> Walls:
    """Per pair of neighbouring cells i < j the longest straight wall between them, (2, 2) end points [m]."""
    edges = [_edges(cell) for cell in cells]
    boxes_m = shapely.bounds(cells)
    walls = {}
    for i, j in combinations(range(len(cells)), 2):
        apart = np.maximum(boxes_m[i, :2], boxes_m[j, :2]) - np.minimum(boxes_m[i, 2:], boxes_m[j, 2:])
        if apart.max() > COLLINEAR_M:
            continue
        wall = _longest_overlap(edges[i], edges[j])
        if wall is not None:
            walls[i, j] = wall
    return walls


def merged(
    cells: list[Polygon], rng: np.random.Generator, *, share: float, max_area_m2: float
) -> list[Polygon]:
    """Cells with some neighbours joined to one room, as L and T shapes come about.

    `share` is the probability that a pair of small neighbours is joined; no joined room exceeds the limit.
    """
    joined = list(cells)
    gone: set[int] = set()
    for (i, j), wall_m in shared_walls(cells).items():
        area_m2 = joined[i].area + joined[j].area
        long_enough = np.linalg.norm(wall_m[1] - wall_m[0]) > 1.6
        if {i, j} & gone or area_m2 > max_area_m2 or not long_enough or rng.random() >= share:
            continue
        union = shapely.union(joined[i], joined[j], grid_size=1e-7).simplify(1e-5)
        if not isinstance(union, Polygon) or not is_compact(union):
            continue
        joined[i] = union
        gone |= {i, j}
        joined[j] = Polygon()
    return [cell for cell in joined if not cell.is_empty]


def is_compact(cell: Polygon) -> bool:
    """Whether a room is not wrapped around others: it fills most of its convex hull."""
    return bool(cell.area > 0.62 * cell.convex_hull.area)


def _bites(rng: np.random.Generator, form: str, width_m: float, depth_m: float) -> list[Polygon]:
    """Boxes to take out of a rectangle."""
    if form == "rectangle":
        return []
    # Uniform: the bite takes 25 to 45 % of either side.
    w, d = width_m * rng.uniform(0.25, 0.45), depth_m * rng.uniform(0.25, 0.45)
    right, upper = rng.random() < 0.5, rng.random() < 0.5
    y0, y1 = (depth_m - d, depth_m) if upper else (0.0, d)
    if form == "L":
        return [box(width_m - w, y0, width_m, y1) if right else box(0.0, y0, w, y1)]
    if form == "T":
        return [box(0.0, y0, 0.8 * w, y1), box(width_m - 0.8 * w, y0, width_m, y1)]
    middle = width_m * rng.uniform(0.4, 0.6)
    return [box(middle - 0.35 * w, y0, middle + 0.35 * w, y1)]


def _slanted(shell: Polygon, rng: np.random.Generator) -> Polygon:
    """The shell with a corner cut off, or with one side turned by up to 8 degrees."""
    x0, y0, x1, y1 = shell.bounds
    width_m, depth_m = x1 - x0, y1 - y0
    if rng.random() < 0.5:
        corner_x, corner_y = rng.choice([x0, x1]), rng.choice([y0, y1])
        # Uniform: the cut runs 1.2 to 3 m along either side.
        dx = rng.uniform(1.2, 3.0) * (1.0 if corner_x == x0 else -1.0)
        dy = rng.uniform(1.2, 3.0) * (1.0 if corner_y == y0 else -1.0)
        wedge = Polygon([(corner_x, corner_y), (corner_x + dx, corner_y), (corner_x, corner_y + dy)])
    else:
        rise_m = min(width_m * math.tan(rng.uniform(math.radians(3.0), math.radians(8.0))), 0.2 * depth_m)
        wedge = Polygon([(x0, y1), (x1, y1), (x1, y1 - rise_m)])
    cut = shell.difference(wedge)
    return cut if isinstance(cut, Polygon) else shell


def _cut(cell: Polygon, rng: np.random.Generator, *, tilted: bool) -> list[Polygon]:
    x0, y0, x1, y1 = cell.bounds
    across_x = (x1 - x0 >= y1 - y0) == (rng.random() < 0.9)
    # Uniform position; tilts are uniform and at least 5 degrees, else they would pass for noise.
    position = rng.uniform(0.3, 0.7)
    tilt_rad = rng.choice([-1.0, 1.0]) * rng.uniform(math.radians(5.0), math.radians(16.0)) if tilted else 0.0
    heading_rad = tilt_rad + (0.5 * math.pi if across_x else 0.0)
    if across_x:
        through = np.array([x0 + position * (x1 - x0), 0.5 * (y0 + y1)])
    else:
        through = np.array([0.5 * (x0 + x1), y0 + position * (y1 - y0)])
    reach = 100.0 * np.array([math.cos(heading_rad), math.sin(heading_rad)])
    return list(shapely.ops.split(cell, LineString([through - reach, through + reach])).geoms)


def _is_roomy(cell: Polygon, min_side_m: float) -> bool:
    """Whether a square of nearly this side fits, and no part is much narrower."""
    core = cell.buffer(-0.49 * min_side_m, join_style="mitre")
    if core.is_empty or not isinstance(core, Polygon):
        return False
    return bool(core.buffer(0.49 * min_side_m, join_style="mitre").area > 0.93 * cell.area)


def _edges(cell: Polygon) -> Array:
    """(E, 2, 2) start and end of every edge."""
    ring_m = np.asarray(shapely.remove_repeated_points(cell.exterior, 1e-6).coords)
    return np.stack([ring_m[:-1], ring_m[1:]], axis=1)


def _longest_overlap(edges_a: Array, edges_b: Array) -> Array | None:
    """The longest stretch that lies on an edge of either cell."""
    along = edges_a[:, 1] - edges_a[:, 0]
    length_m = np.linalg.norm(along, axis=1)
    along = along / length_m[:, None]
    relative = edges_b[None] - edges_a[:, None, None, 0]
    aside_m = along[:, None, None, 0] * relative[..., 1] - along[:, None, None, 1] * relative[..., 0]
    ahead_m = (relative * along[:, None, None]).sum(axis=-1)
    start_m = np.maximum(ahead_m.min(axis=-1), 0.0)
    end_m = np.minimum(ahead_m.max(axis=-1), length_m[:, None])
    overlap_m = np.where(np.abs(aside_m).max(axis=-1) < COLLINEAR_M * 100.0, end_m - start_m, 0.0)
    a, b = np.unravel_index(int(overlap_m.argmax()), overlap_m.shape)
    if overlap_m[a, b] < 0.01:
        return None
    ends_m: Array = edges_a[a, 0] + along[a] * np.array([[start_m[a, b]], [end_m[a, b]]])
    return ends_m
