"""Repair floor plans, and judge whether two robots can explore them and meet."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np
import shapely
from shapely import MultiPolygon, Point, Polygon
from shapely.geometry.base import BaseGeometry

from rendezvous.errors import FloorplanError, require_within
from rendezvous.floorplan.records import Floorplan
from rendezvous.floorplan.work import check_close_walls, check_crossings, check_work
from rendezvous.geometry.se2 import Array

PRECISION_M = 0.001  # vertices lie on this grid, so that a plan written and read again is the same
RASTER_STEP_M = 0.01
"""HouseExpo's outlines were traced on pixels of this size; a vertex closer to a straight line is noise."""
JOINT_M = 0.01  # half the side of the square that joins two walls which meet in a point
HALF_DOORS_M = (0.6, 0.75, 0.9)  # half widths of the openings that separate rooms: doors, then archways
FARTHEST_M = 10_000.0  # from the origin, at most: there GLB's 32 bits resolve a millimetre
START_MARGIN_M = 0.145  # from a start region to the walls, to within 4 cm where they have corners
PASSAGE_MARGIN_M = 0.03  # a robot passes an opening if it is wider than its diameter by twice this


@dataclass(frozen=True, slots=True, kw_only=True)
class FloorplanLimits:
    """Limits that a usable plan keeps."""

    # min_side_m, max_side_m: range of both sides of the plan's bounding box.
    min_side_m: float = 3.0
    max_side_m: float = 60.0
    # min_area_m2, max_area_m2: range of the free area.
    min_area_m2: float = 15.0
    max_area_m2: float = 1500.0
    # An outline that crosses or touches itself is repaired if the parts lost are thinner.
    crossing_m: float = 0.05
    min_reachable_share: float = 0.8  # smallest share, in one piece, of the area that the robot fits in
    min_start_regions: int = 2  # number of rooms to start in

    def __post_init__(self) -> None:
        require_within(
            self, min_side_m=(1e-3, self.max_side_m), max_side_m=(0, 1e5),
            min_area_m2=(1e-6, self.max_area_m2), max_area_m2=(0, 1e10), crossing_m=(0, 1e5),
            min_reachable_share=(0, 1), min_start_regions=(0, 1000),
        )  # fmt: skip


DEFAULT_LIMITS = FloorplanLimits()


def validated(
    floorplan: Floorplan, *, robot_radius_m: float, limits: FloorplanLimits = DEFAULT_LIMITS
) -> Floorplan:
    """The plan with its small faults repaired, outline counter-clockwise, holes clockwise, on the mm grid.

    A validated plan comes back as it is.

    Raises:
        FloorplanError: the plan cannot be used.
    """
    check_work(floorplan)
    _check_extent(floorplan, limits)
    free = _repaired(floorplan, limits)
    _check_area(floorplan, free, limits)
    repaired = replace(
        floorplan,
        outline_m=_vertices(free.exterior),
        holes_m=tuple(_vertices(ring) for ring in free.interiors),
    )
    check_close_walls(repaired, HALF_DOORS_M[-1])
    _check_reachable(repaired, robot_radius_m + PASSAGE_MARGIN_M, limits)
    regions = start_regions(repaired, robot_radius_m=robot_radius_m)
    if len(regions) < limits.min_start_regions:
        raise FloorplanError(
            f"{floorplan.plan_id}: {len(regions)} room(s) to start in, around {_at(free)}; two robots need "
            f"at least {limits.min_start_regions} rooms with a doorway under {2 * HALF_DOORS_M[-1]:.1f} m "
            "between them"
        )
    return repaired


def reachable_space(floorplan: Floorplan, *, robot_radius_m: float) -> Polygon:
    """Where the centre of a robot of this radius can be: the largest piece of the eroded free space [m].

    Raises:
        FloorplanError: the robot fits nowhere.
    """
    pieces = _polygons(floorplan.free_space().buffer(-robot_radius_m, quad_segs=4))
    if not pieces:
        raise FloorplanError(f"{floorplan.plan_id}: a robot of radius {robot_radius_m} m fits nowhere in it")
    return max(pieces, key=lambda piece: piece.area)


def start_regions(floorplan: Floorplan, *, robot_radius_m: float) -> tuple[Polygon, ...]:
    """Disjoint parts of the rooms in which a robot may start, largest first [m].

    A room is a piece of the free space eroded by half a doorway, grown back up to where a robot keeps
    `START_MARGIN_M` from the walls. Of several doorway widths, the one that parts the plan into most rooms
    is taken.
    """
    reachable = reachable_space(floorplan, robot_radius_m=robot_radius_m + PASSAGE_MARGIN_M)
    free, clearance_m = floorplan.free_space(), robot_radius_m + START_MARGIN_M
    candidates = [_rooms(free, reachable, half_door_m, clearance_m) for half_door_m in HALF_DOORS_M]
    return max(candidates, key=len)


def _rooms(free: Polygon, reachable: Polygon, half_door_m: float, clearance_m: float) -> tuple[Polygon, ...]:
    cores = _polygons(free.buffer(-half_door_m, quad_segs=4))
    shapely.prepare(reachable)
    cores = [core for core in cores if core.area > 0.05 and reachable.contains(core.representative_point())]
    cores.sort(key=lambda core: (-core.area, core.bounds))
    rooms: list[Polygon] = []
    for core in cores:
        room = core.buffer(half_door_m - clearance_m, quad_segs=2)
        for other in rooms:
            if room.intersects(other):
                room = max(_polygons(room.difference(other)), key=lambda piece: piece.area)
        rooms.append(room)
    return tuple(rooms)


def _check_extent(floorplan: Floorplan, limits: FloorplanLimits) -> None:
    low_m, high_m = floorplan.outline_m.min(axis=0), floorplan.outline_m.max(axis=0)
    width_m, depth_m = high_m - low_m
    if not (limits.min_side_m <= min(width_m, depth_m) and max(width_m, depth_m) <= limits.max_side_m):
        hint = "; pixels or millimetres?" if max(width_m, depth_m) > 3.0 * limits.max_side_m else ""
        raise FloorplanError(
            f"{floorplan.plan_id}: {width_m:.4g} m x {depth_m:.4g} m from {_point(low_m)}; the sides must "
            f"be {limits.min_side_m:g} to {limits.max_side_m:g} m, coordinates in metres{hint}"
        )
    if max(-low_m.min(), high_m.max()) > FARTHEST_M:
        raise FloorplanError(
            f"{floorplan.plan_id}: lies at ({low_m[0]:.6g}, {low_m[1]:.6g}) m; must lie within "
            f"{FARTHEST_M:g} m of the origin: take a corner of the plan for it"
        )


def _check_area(floorplan: Floorplan, free: Polygon, limits: FloorplanLimits) -> None:
    if not limits.min_area_m2 <= free.area <= limits.max_area_m2:
        raise FloorplanError(
            f"{floorplan.plan_id}: {free.area:.1f} m2 of free space around {_at(free)}; must be "
            f"{limits.min_area_m2:g} to {limits.max_area_m2:g} m2"
        )


def _check_reachable(floorplan: Floorplan, radius_m: float, limits: FloorplanLimits) -> None:
    pieces = _polygons(floorplan.free_space().buffer(-radius_m, quad_segs=4))
    pieces.sort(key=lambda piece: piece.area, reverse=True)
    area_m2 = sum(piece.area for piece in pieces)
    if not pieces or pieces[0].area < limits.min_reachable_share * area_m2:
        share = pieces[0].area / area_m2 if pieces else 0.0
        cut_off = pieces[1] if pieces else floorplan.free_space()
        raise FloorplanError(
            f"{floorplan.plan_id}: a robot of radius {radius_m:.3f} m reaches {100.0 * share:.0f} % of the "
            f"free space, not the part around {_at(cut_off)}; must reach "
            f"{100.0 * limits.min_reachable_share:.0f} %"
        )


def _repaired(floorplan: Floorplan, limits: FloorplanLimits) -> Polygon:
    """One clean polygon on the mm grid, without duplicate and collinear vertices, counter-clockwise."""
    free = floorplan.free_space()
    if not _is_clean(free):
        check_crossings(floorplan)
        free = _uncrossed(floorplan, limits)
    for _ in range(3):
        free = _simplified(_largest(shapely.set_precision(free, PRECISION_M)))
        if _is_clean(free):
            return shapely.orient_polygons(free)
        free = _joined(free)
    raise FloorplanError(f"{floorplan.plan_id}: {_fault(free)}; an outline must be a simple polygon")


def _uncrossed(floorplan: Floorplan, limits: FloorplanLimits) -> Polygon:
    """The free space of an outline that touches or crosses itself a little."""
    outline = Polygon(floorplan.outline_m)
    # The regions around which the ring goes at all, and an odd number of times, differ where it overlaps
    # itself.
    enclosed = shapely.make_valid(outline, method="structure", keep_collapsed=False)
    alternating = shapely.make_valid(outline, method="linework")
    main = _largest(enclosed)
    lost = _polygons(enclosed.symmetric_difference(alternating)) + _polygons(enclosed.difference(main))
    for part in lost:
        if not part.buffer(-0.5 * limits.crossing_m).is_empty:
            raise FloorplanError(
                f"{floorplan.plan_id}: {_fault(outline)}, {part.area:.2f} m2 around {_at(part)} would be "
                f"lost; an outline must be a simple polygon, faults under {limits.crossing_m} m are repaired"
            )
    islands = [shapely.make_valid(Polygon(hole_m)) for hole_m in floorplan.holes_m]
    return _largest(main.difference(shapely.union_all(islands)))


def _joined(free: Polygon) -> Polygon:
    """The free space without the points where two of its rings touch: walls that meet there are joined."""
    rings = [free.exterior, *free.interiors]
    contacts = [ring.intersection(other) for i, ring in enumerate(rings) for other in rings[:i]]
    joints = shapely.union_all(contacts).buffer(JOINT_M, cap_style="square")
    return _largest(free.difference(joints))


def _simplified(free: Polygon) -> Polygon:
    """Simplified until nothing changes, so that validating twice is validating once."""
    while True:
        # The vertices removed depend on where the ring starts; normalised, it starts at its smallest vertex.
        free = free.normalize()
        simpler = free.simplify(RASTER_STEP_M, preserve_topology=True)
        if shapely.get_num_coordinates(simpler) == shapely.get_num_coordinates(free):
            return free
        free = simpler


def _is_clean(free: Polygon) -> bool:
    """Valid, and no two rings touch: a point where two walls meet would make a mesh that leaks."""
    if not free.is_valid:
        return False
    rings = [free.exterior, *free.interiors]
    return not any(ring.intersects(other) for i, ring in enumerate(rings) for other in rings[:i])


def _polygons(geometry: BaseGeometry) -> list[Polygon]:
    parts: Iterable[BaseGeometry] = shapely.get_parts(geometry)
    flat = [p for part in parts for p in (part.geoms if isinstance(part, MultiPolygon) else (part,))]
    return [p for p in flat if isinstance(p, Polygon) and not p.is_empty]


def _largest(geometry: BaseGeometry) -> Polygon:
    return max(_polygons(geometry), key=lambda part: part.area, default=Polygon())


def _vertices(ring: BaseGeometry) -> Array:
    # Adding 0 turns -0.0 into 0.0.
    return np.asarray(ring.coords[:-1], dtype=np.float64) + 0.0


def _fault(free: Polygon) -> str:
    """GEOS's verdict, e.g. "Self-intersection[1.5 2]", in words."""
    reason = re.fullmatch(r"(.*?)\[(\S+) (\S+)\]", shapely.is_valid_reason(free))
    if reason is None:
        return f"the outline or a hole touches another around {_at(free)}"
    kind, x_m, y_m = reason.groups()
    verb = "touches" if kind.startswith("Ring") else "crosses"
    return f"the outline {verb} itself at {_point((float(x_m), float(y_m)))}"


def _at(part: BaseGeometry) -> str:
    point: Point = part.representative_point()
    return _point((point.x, point.y)) if not point.is_empty else "nowhere"


def _point(xy_m: Array | tuple[float, float]) -> str:
    return f"({xy_m[0]:.2f}, {xy_m[1]:.2f}) m"
