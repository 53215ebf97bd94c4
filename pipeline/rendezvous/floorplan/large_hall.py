"""Large halls with few walls: free-standing things in rows that repeat, or furniture that may be moved."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise

import numpy as np
import shapely
from shapely import Polygon, affinity, box

from rendezvous.floorplan.layouts import Storey, office_categories, sides
from rendezvous.floorplan.partition import footprint, subdivided

_CLEAR_M = 1.2  # from walls, doors and the next zone to what stands in a hall

Unit = tuple[list[Polygon], float, float]  # one of a row around the origin, and its width and depth [m]
Draw = Callable[[np.random.Generator], Unit]


def large_hall(rng: np.random.Generator, *, slanted: bool) -> Storey:
    """One or two halls of 15 to 30 m with stands, pallets, desks, cubicles or columns in rows; side rooms."""
    halls, rooms = _cells(rng, slanted=slanted)
    posts = [post for cell in halls for zone in _zones(cell, rng) for post in _standing(zone, cell, rng)]
    categories = ["Large_Hall"] * len(halls) + office_categories(rooms, rng)
    return Storey(cells=[*halls, *rooms], categories=categories, hub=0, posts=posts)


def warehouse(rng: np.random.Generator, *, slanted: bool) -> Storey:
    """One or two such halls, bare but for columns in half of them; pallets and stalls come as furniture."""
    halls, rooms = _cells(rng, slanted=slanted)
    posts = [post for cell in halls if rng.random() < 0.5 for post in _rows(_column, cell, cell, rng)]
    categories = ["Warehouse"] * len(halls) + office_categories(rooms, rng)
    return Storey(cells=[*halls, *rooms], categories=categories, hub=0, posts=posts)


def _cells(rng: np.random.Generator, *, slanted: bool) -> tuple[list[Polygon], list[Polygon]]:
    """The halls, and the rooms beside them."""
    # Uniform sizes: 180 to 720 m2.
    width_m, depth_m = rng.uniform(15.0, 30.0), rng.uniform(12.0, 24.0)
    shell = footprint(rng, width_m=width_m, depth_m=depth_m, slanted=slanted and rng.random() < 0.5)
    open_space, strips = sides(shell, rng)
    rooms = subdivided(strips, rng, room_area_m2=rng.uniform(14.0, 40.0), min_side_m=2.4, slant=0.0)
    halls = subdivided([open_space], rng, room_area_m2=rng.uniform(250.0, 600.0), min_side_m=8.0, slant=0.0)
    return halls, rooms


def _zones(cell: Polygon, rng: np.random.Generator) -> list[Polygon]:
    """One to three parts of a hall's box, along its longer side, an aisle apart."""
    x0, y0, x1, y1 = cell.buffer(-_CLEAR_M).bounds
    along_x = x1 - x0 >= y1 - y0
    low, high = (x0, x1) if along_x else (y0, y1)
    # Uniform: up to one zone per 6 m, of unequal lengths.
    count = int(rng.integers(1, min(3, max(1, int((high - low) / 6.0))) + 1))
    ends = low + (high - low) * np.cumsum(np.r_[0.0, rng.dirichlet(np.full(count, 8.0))])
    spans = [
        (a + 0.5 * _CLEAR_M * (i > 0), b - 0.5 * _CLEAR_M * (i < count - 1))
        for i, (a, b) in enumerate(pairwise(ends.tolist()))
    ]
    return [box(a, y0, b, y1) if along_x else box(x0, a, x1, b) for a, b in spans]


def _standing(zone: Polygon, cell: Polygon, rng: np.random.Generator) -> list[Polygon]:
    """Rows of one kind of thing."""
    # Categorical, uniform over the kinds.
    draw: Draw = (_stand, _pallet, _desks, _cubicle, _column)[int(rng.integers(5))]
    return _rows(draw, zone, cell, rng)


def _rows(draw: Draw, zone: Polygon, cell: Polygon, rng: np.random.Generator) -> list[Polygon]:
    """The same thing again and again, but for some that are missing or a little askew."""
    unit, width_m, depth_m = draw(rng)
    loose = draw is _pallet
    # Uniform gaps between neighbours and rows: robots pass all of them.
    pitch_x = width_m + (rng.uniform(2.5, 5.0) if draw is _column else rng.uniform(0.8, 1.8))
    pitch_y = depth_m + (rng.uniform(2.5, 5.0) if draw is _column else rng.uniform(1.0, 2.2))
    missing = rng.uniform(0.0, 0.3)
    quarter = 90.0 * float(rng.integers(2))
    x0, y0, x1, y1 = affinity.rotate(zone, -quarter, origin=(0.0, 0.0)).bounds
    inner = cell.buffer(-_CLEAR_M)
    shapely.prepare(inner)
    things: list[Polygon] = []
    for y_m in np.arange(y0 + 0.5 * depth_m, y1 - 0.5 * depth_m + 1e-9, pitch_y):
        for x_m in np.arange(x0 + 0.5 * width_m, x1 - 0.5 * width_m + 1e-9, pitch_x):
            # Normal: pallets stand where a truck set them down.
            dx, dy, askew_deg = rng.normal(0.0, [0.06, 0.06, 3.0]) if loose else (0.0, 0.0, 0.0)
            if rng.random() < missing:
                continue
            placed = [_moved(part, x_m + dx, y_m + dy, askew_deg, quarter) for part in unit]
            if all(inner.contains(part) for part in placed):
                things += placed
    return things


def _moved(part: Polygon, x_m: float, y_m: float, askew_deg: float, quarter_deg: float) -> Polygon:
    there = affinity.translate(affinity.rotate(part, askew_deg, origin=(0.0, 0.0)), x_m, y_m)
    return affinity.rotate(there, quarter_deg, origin=(0.0, 0.0))


def _stand(rng: np.random.Generator) -> Unit:
    """A stand of a fair: a back wall, and sides that come all or half of the way forward."""
    width_m, depth_m, wall_m = rng.uniform(2.0, 4.0), rng.uniform(1.6, 3.0), rng.uniform(0.05, 0.1)
    side_m = depth_m * rng.uniform(0.4, 1.0)
    x, y = 0.5 * width_m, 0.5 * depth_m
    walls = [box(-x, -y, x, wall_m - y), box(-x, -y, wall_m - x, side_m - y)]
    if rng.random() < 0.7:
        walls.append(box(x - wall_m, -y, x, side_m - y))
    return [_one(walls)], width_m, depth_m


def _pallet(rng: np.random.Generator) -> Unit:
    """A loaded pallet, or two side by side."""
    count = int(rng.integers(1, 3))
    return [box(-0.6, -0.4 * count, 0.6, 0.4 * count)], 1.2, 0.8 * count


def _desks(rng: np.random.Generator) -> Unit:
    """Two desks back to back, as the lidar sees them: side panels, and a screen between."""
    width_m, depth_m, panel_m = rng.uniform(1.2, 1.8), rng.uniform(1.3, 1.6), rng.uniform(0.03, 0.05)
    x, y = 0.5 * width_m, 0.5 * depth_m - 0.05
    sides_m = [box(s * x - 0.5 * panel_m, -y, s * x + 0.5 * panel_m, y) for s in (-1, 1)]
    return [_one([*sides_m, box(-x, -0.5 * panel_m, x, 0.5 * panel_m)])], width_m + panel_m, depth_m


def _cubicle(rng: np.random.Generator) -> Unit:
    """A work place between partitions, open at the front for half of its width."""
    side_m, wall_m = rng.uniform(1.8, 2.6), rng.uniform(0.05, 0.08)
    h = 0.5 * side_m
    front_m = side_m - rng.uniform(0.85, 1.2)
    walls = [box(-h, h - wall_m, h, h), box(-h, -h, wall_m - h, h), box(h - wall_m, -h, h, h)]
    return [_one([*walls, box(-h, -h, front_m - h, wall_m - h)])], side_m, side_m


def _column(rng: np.random.Generator) -> Unit:
    """A square or round column."""
    half_m = rng.uniform(0.12, 0.35)
    if rng.random() < 0.4:
        return [shapely.Point(0.0, 0.0).buffer(half_m, quad_segs=3)], 2 * half_m, 2 * half_m
    return [box(-half_m, -half_m, half_m, half_m)], 2 * half_m, 2 * half_m


def _one(walls: list[Polygon]) -> Polygon:
    joined = shapely.union_all(walls)
    assert isinstance(joined, Polygon), "the walls of a unit touch each other"
    return joined
