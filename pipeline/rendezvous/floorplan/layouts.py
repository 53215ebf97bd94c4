"""Layouts of storeys: apartments, offices along corridors, halls with side rooms."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import shapely
from shapely import Polygon, affinity, box

from rendezvous.floorplan.partition import footprint, merged, shared_walls, subdivided
from rendezvous.geometry.se2 import Array


@dataclass(frozen=True, slots=True, kw_only=True)
class Storey:
    """Rooms that meet in the middle of their walls, before walls get a thickness and doors."""

    cells: list[Polygon]  # the rooms [m]; they tile the storey
    categories: list[str]  # one per cell
    hub: int  # index of the cell onto which others open: corridor, living room or hall
    posts: list[Polygon]  # pillars and free-standing walls [m]


def apartment(rng: np.random.Generator, *, slanted: bool) -> Storey:
    """A flat: rooms around a living room or along a short corridor."""
    # Uniform sizes: 45 to 190 m2.
    width_m, depth_m = rng.uniform(7.5, 15.0), rng.uniform(6.5, 12.5)
    shell = footprint(rng, width_m=width_m, depth_m=depth_m, slanted=slanted and rng.random() < 0.6)
    slant = 0.3 if slanted else 0.0
    room_area_m2 = rng.uniform(9.0, 17.0)
    if width_m * depth_m > 80.0 and rng.random() < 0.5:
        hall = _band(shell, rng, width_m=rng.uniform(1.15, 1.7), full_length=False)
        pieces = _polygons(shell.difference(hall))
        rooms = subdivided(pieces, rng, room_area_m2=room_area_m2, min_side_m=1.9, slant=slant)
        cells = [hall, *merged(rooms, rng, share=0.12, max_area_m2=30.0)]
        categories = ["Hall", *_home_categories(cells[1:], rng)]
        return Storey(cells=cells, categories=categories, hub=0, posts=[])
    rooms = subdivided([shell], rng, room_area_m2=room_area_m2, min_side_m=1.9, slant=slant)
    cells = merged(rooms, rng, share=0.15, max_area_m2=34.0)
    categories = _home_categories(cells, rng)
    return Storey(cells=cells, categories=categories, hub=_best_hub(cells), posts=[])


def office(rng: np.random.Generator, *, slanted: bool) -> Storey:
    """Rooms along a straight, L- or T-shaped corridor, or around one that closes to a ring."""
    # Uniform sizes: 90 to 270 m2.
    width_m, depth_m = rng.uniform(11.0, 19.0), rng.uniform(8.5, 14.0)
    shell = footprint(rng, width_m=width_m, depth_m=depth_m, slanted=slanted and rng.random() < 0.5)
    corridor_m = rng.uniform(1.3, 2.2)
    if min(width_m, depth_m) > 11.0 and rng.random() < 0.5:
        corridor = _ring(shell, rng, width_m=corridor_m)
    else:
        corridor = _band(shell, rng, width_m=corridor_m, full_length=True)
        if rng.random() < 0.5:
            branch = _band(shell, rng, width_m=corridor_m, full_length=True, across=True)
            ends = _polygons(branch.difference(corridor))
            corridor = _largest(corridor.union(ends[int(rng.integers(len(ends)))]))
    pieces = _polygons(shell.difference(corridor))
    slant = 0.25 if slanted else 0.0
    rooms = subdivided(pieces, rng, room_area_m2=rng.uniform(11.0, 22.0), min_side_m=2.2, slant=slant)
    cells = [corridor, *merged(rooms, rng, share=0.1, max_area_m2=45.0)]
    posts = [post for cell in cells[1:] if cell.area > 32.0 for post in _pillars(cell, rng)]
    return Storey(
        cells=cells, categories=["Corridor", *office_categories(cells[1:], rng)], hub=0, posts=posts
    )


def hall(rng: np.random.Generator, *, slanted: bool) -> Storey:
    """One or two halls with pillars and screens, rooms along one or two sides."""
    # Uniform sizes: 110 to 290 m2.
    width_m, depth_m = rng.uniform(11.0, 18.0), rng.uniform(10.0, 16.0)
    shell = footprint(rng, width_m=width_m, depth_m=depth_m, slanted=slanted and rng.random() < 0.7)
    open_space, strips = sides(shell, rng)
    slant = 0.2 if slanted else 0.0
    rooms = subdivided(strips, rng, room_area_m2=rng.uniform(9.0, 18.0), min_side_m=2.2, slant=slant)
    halls = subdivided([open_space], rng, room_area_m2=rng.uniform(60.0, 110.0), min_side_m=4.5, slant=slant)
    posts: list[Polygon] = []
    for cell in halls:
        pillars = _pillars(cell, rng)
        posts += [*pillars, *_screens(cell, rng, pillars)]
    categories = ["Hall"] * len(halls) + office_categories(rooms, rng)
    return Storey(cells=[*halls, *rooms], categories=categories, hub=0, posts=posts)


def tapered(layout: Storey, rng: np.random.Generator) -> Storey:
    """The layout of a building that narrows to one side.

    A mild projective map: straight walls stay straight.
    """
    # Uniform: 0.6 to 1.6 % per metre.
    k = rng.choice([-1.0, 1.0]) * rng.uniform(0.006, 0.016)
    along_x = rng.random() < 0.5
    x0, y0, x1, y1 = shapely.union_all(layout.cells).bounds
    centre = np.array([0.5 * (x0 + x1), 0.5 * (y0 + y1)])

    def taper(xy_m: Array) -> Array:
        relative = xy_m - centre
        return centre + relative / (1.0 + k * relative[:, 0 if along_x else 1])[:, None]

    return replace(
        layout,
        cells=[shapely.transform(cell, taper) for cell in layout.cells],
        posts=[shapely.transform(post, taper) for post in layout.posts],
    )


def _band(
    shell: Polygon, rng: np.random.Generator, *, width_m: float, full_length: bool, across: bool = False
) -> Polygon:
    """A corridor along the shell's longer side, or across; not in full length it ends inside."""
    x0, y0, x1, y1 = shell.bounds
    along_x = (x1 - x0 >= y1 - y0) != across
    lo, hi, a, b = (y0, y1, x0, x1) if along_x else (x0, x1, y0, y1)
    # Uniform: the corridor's middle lies in the middle third; a short one ends up to 40 % before the end.
    middle = lo + rng.uniform(0.36, 0.64) * (hi - lo)
    length_m = (b - a) * (1.0 if full_length else rng.uniform(0.6, 0.8))
    start = a if rng.random() < 0.5 else b - length_m
    low, high = middle - 0.5 * width_m, middle + 0.5 * width_m
    band = box(start, low, start + length_m, high) if along_x else box(low, start, high, start + length_m)
    return _largest(band.intersection(shell))


def _ring(shell: Polygon, rng: np.random.Generator, *, width_m: float) -> Polygon:
    """A corridor that goes around a core of rooms."""
    x0, y0, x1, y1 = shell.bounds
    # Uniform: rooms outside the ring are 2.6 to 3.4 m deep.
    inset = rng.uniform(2.6, 3.4, size=4)
    outer = box(x0 + inset[0], y0 + inset[1], x1 - inset[2], y1 - inset[3])
    return _largest(outer.difference(outer.buffer(-width_m, join_style="mitre")).intersection(shell))


def sides(shell: Polygon, rng: np.random.Generator) -> tuple[Polygon, list[Polygon]]:
    """The shell without, and the strips for side rooms along one or two sides."""
    x0, y0, x1, y1 = shell.bounds
    # Uniform: 2.6 to 4 m deep.
    d = rng.uniform(2.6, 4.0, size=4)
    strips = [
        box(x0, y0, x0 + d[0], y1),
        box(x1 - d[1], y0, x1, y1),
        box(x0, y0, x1, y0 + d[2]),
        box(x0, y1 - d[3], x1, y1),
    ]
    chosen = rng.permutation(4)[: int(rng.integers(1, 3))]
    taken: list[Polygon] = []
    open_space = shell
    for side in chosen:
        taken += _polygons(open_space.intersection(strips[side]))
        open_space = _largest(open_space.difference(strips[side]))
    return open_space, taken


def _pillars(cell: Polygon, rng: np.random.Generator) -> list[Polygon]:
    """Square or round pillars on a grid of 3 to 4.2 m, at least 1 m clear of the walls."""
    x0, y0, x1, y1 = cell.bounds
    spacing_x, spacing_y = rng.uniform(3.0, 4.2, size=2)
    columns, rows = max(int((x1 - x0) / spacing_x), 1), max(int((y1 - y0) / spacing_y), 1)
    half_m = rng.uniform(0.12, 0.28)
    round_ = rng.random() < 0.4
    inner = cell.buffer(-(1.0 + half_m))
    pillars = []
    for x_m in x0 + (x1 - x0) * (np.arange(1, columns + 1) / (columns + 1)):
        for y_m in y0 + (y1 - y0) * (np.arange(1, rows + 1) / (rows + 1)):
            centre = shapely.Point(x_m, y_m)
            pillar = (
                centre.buffer(half_m, quad_segs=3) if round_ else centre.buffer(half_m, cap_style="square")
            )
            if inner.contains(centre):
                pillars.append(pillar)
    return pillars


def _screens(cell: Polygon, rng: np.random.Generator, pillars: list[Polygon]) -> list[Polygon]:
    """Free-standing walls, straight or with a corner, at any angle, about one per 35 m2."""
    x0, y0, x1, y1 = cell.bounds
    inner = cell.buffer(-1.1)
    screens: list[Polygon] = []
    for _ in range(int(rng.poisson(cell.area / 35.0))):
        length_m, arm_m, half_m = rng.uniform(1.5, 3.5), rng.uniform(0.8, 2.0), rng.uniform(0.05, 0.12)
        screen = box(0.0, -half_m, length_m, half_m)
        if rng.random() < 0.4:
            screen = screen.union(box(-half_m, -half_m, half_m, arm_m))
        # Mostly square to the building, one in four at any angle.
        angle_deg = 90.0 * rng.integers(4) if rng.random() < 0.75 else rng.uniform(0.0, 360.0)
        turned = affinity.rotate(screen, angle_deg, origin=(0.0, 0.0))
        placed = affinity.translate(turned, rng.uniform(x0, x1), rng.uniform(y0, y1))
        if inner.contains(placed) and all(placed.distance(post) > 0.9 for post in (*pillars, *screens)):
            screens.append(placed)
    return screens


def _best_hub(cells: list[Polygon]) -> int:
    """The cell with most neighbours, the larger one of equals."""
    degree = np.zeros(len(cells), dtype=np.int64)
    for pair in shared_walls(cells):
        degree[list(pair)] += 1
    return max(range(len(cells)), key=lambda i: (degree[i], cells[i].area))


def _home_categories(cells: list[Polygon], rng: np.random.Generator) -> list[str]:
    """The largest room is the living room, the smallest the bathroom, then a kitchen and bedrooms."""
    names = [""] * len(cells)
    by_area = sorted(range(len(cells)), key=lambda i: -cells[i].area)
    extra = ["Bedroom", "Bedroom", "Office", "Dining_Room", "Child_Room", "Guest_Room", "Storage"]
    for rank, i in enumerate(by_area):
        names[i] = str(rng.choice(extra)) if cells[i].area > 6.0 else "Storage"
        if rank == 0:
            names[i] = "Living_Room"
    if len(cells) > 2:
        names[by_area[-1]] = "Bathroom"
        names[by_area[len(cells) // 2]] = "Kitchen"
    if len(cells) > 3:
        names[by_area[1]] = "Bedroom"
    return names


def office_categories(cells: list[Polygon], rng: np.random.Generator) -> list[str]:
    names = [
        str(rng.choice(["Office", "Meeting_Room"], p=[0.75, 0.25])) if cell.area > 9.0 else "Storage"
        for cell in cells
    ]
    by_area = sorted(range(len(cells)), key=lambda i: cells[i].area)
    for i, name in zip(by_area, ("Toilet", "Kitchen"), strict=False):
        if len(cells) > 3:
            names[i] = name
    return names


def _polygons(geometry: shapely.Geometry) -> list[Polygon]:
    """The polygons of a geometry, without slivers."""
    return [part for part in shapely.get_parts(geometry) if isinstance(part, Polygon) and part.area > 0.5]


def _largest(geometry: shapely.Geometry) -> Polygon:
    return max(_polygons(geometry), key=lambda part: part.area)
