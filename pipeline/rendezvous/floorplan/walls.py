"""Walls as polygons, as boxes, and as the faces that sensors see."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import shapely
from shapely import MultiPolygon, Polygon

from rendezvous.floorplan.records import Floorplan, Shape, Solid
from rendezvous.floorplan.validate import PRECISION_M
from rendezvous.geometry.se2 import Array

THICKNESSES_M = (0.1, 0.07, 0.05, 0.035, 0.025, 0.015, 0.01, 0.005, 0.002)
"""A wall box is as thick as the wall behind its face allows, of these."""
MAX_TRIM_M = 0.02  # the most that a box stops short of a sharp corner, unless it is already the thinnest
ROUNDING_M = 1e-6


class SightObstacles(NamedTuple):
    """Upright faces and cylinders in w that may hide something."""

    segments_m: Array  # (S, 4) x0, y0, x1, y1
    # bottoms_m, tops_m: (S,) heights of each.
    bottoms_m: Array
    tops_m: Array
    circles_m: Array  # (C, 5) x, y, radius, bottom, top


def wall_polygon(floorplan: Floorplan, *, thickness_m: float) -> Polygon | MultiPolygon:
    """The solid around the free space [m]: a shell of this thickness, the walls within and the islands."""
    return storey_polygon(floorplan, thickness_m=thickness_m).difference(floorplan.free_space())


def storey_polygon(floorplan: Floorplan, *, thickness_m: float) -> Polygon:
    """All that a storey covers [m], free space and walls, within a shell of this thickness."""
    shell = Polygon(floorplan.outline_m).buffer(thickness_m, join_style="mitre", mitre_limit=2.0)
    # On the plan's own grid: vertices a nanometre apart would make meshes that leak.
    snapped = shapely.set_precision(Polygon(shell.exterior), PRECISION_M)
    # Without the grid that GEOS would else hand on to whatever is computed from it.
    return shapely.set_precision(snapped, 0.0)


def wall_boxes(floorplan: Floorplan, *, height_m: float) -> tuple[Solid, ...]:
    """One box per wall face, standing in the wall, its free side exactly on the face.

    No box reaches into the free space: each is as thick as its wall allows. Where a wall ends in an edge
    sharper than 90 degrees the boxes stop short of it, by 2 cm at most, or some more where it is sharper
    than 6 degrees.
    """
    edges_m = floorplan.edges_m()
    solid = wall_polygon(floorplan, thickness_m=2.0 * THICKNESSES_M[0]).buffer(ROUNDING_M)
    shapely.prepare(solid)
    start_cot, end_cot = _sharp_corner_cotangents(floorplan)
    spans = np.zeros((len(edges_m), 3))
    undecided = np.arange(len(edges_m))
    for thickness_m in THICKNESSES_M:
        thinnest = thickness_m == THICKNESSES_M[-1]
        trims_m = thickness_m * np.stack([start_cot[undecided], end_cot[undecided]], axis=1)
        trial = np.column_stack([trims_m, np.full(len(undecided), thickness_m)])
        corners_m, lengths_m = _boxes_behind(edges_m[undecided], trial)
        fits = (lengths_m > 0.0) & (trims_m.max(axis=1) <= MAX_TRIM_M)
        fits &= shapely.covers(solid, shapely.polygons(corners_m))
        fits |= thinnest & (lengths_m > 0.0)
        spans[undecided[fits]] = trial[fits]
        undecided = undecided[~fits]
    return tuple(
        _wall_box(edge_m, span, height_m)
        for edge_m, span in zip(edges_m, spans, strict=True)
        if span[2] > 0.0
    )


def lidar_outline(floorplan: Floorplan, solids: Sequence[Solid], *, height_m: float) -> tuple[Array, Array]:
    """All that a level scan at this height can see.

    Returns:
        (S, 4) x0, y0, x1, y1 [m]: all wall faces (free space to their left) and the sides of the boxes.
        (C, 3) x, y, radius [m]: the cylinders.
    """
    cut = [solid for solid in solids if solid.z0_m <= height_m <= solid.z1_m]
    obstacles = sight_obstacles(floorplan, cut, wall_height_m=height_m)
    return obstacles.segments_m, obstacles.circles_m[:, :3]


def sight_obstacles(floorplan: Floorplan, solids: Sequence[Solid], *, wall_height_m: float) -> SightObstacles:
    """All wall faces, the sides of the boxes, and the cylinders."""
    edges_m = floorplan.edges_m()
    boxes = [solid for solid in solids if solid.shape is Shape.BOX]
    rings_m = np.array([box.corners_m() for box in boxes]).reshape(-1, 4, 2)
    sides_m = np.concatenate([rings_m, np.roll(rings_m, -1, axis=1)], axis=2).reshape(-1, 4)
    bottoms_m = np.repeat([box.z0_m for box in boxes], 4)
    tops_m = np.repeat([box.z1_m for box in boxes], 4)
    circles = [
        (solid.x_m, solid.y_m, solid.half_x_m, solid.z0_m, solid.z1_m)
        for solid in solids
        if solid.shape is Shape.CYLINDER
    ]
    return SightObstacles(
        segments_m=np.concatenate([edges_m, sides_m]),
        bottoms_m=np.concatenate([np.zeros(len(edges_m)), bottoms_m]),
        tops_m=np.concatenate([np.full(len(edges_m), wall_height_m), tops_m]),
        circles_m=np.array(circles, dtype=np.float64).reshape(-1, 5),
    )


def _sharp_corner_cotangents(floorplan: Floorplan) -> tuple[Array, Array]:
    """(E,) each, at the start and end of every edge: cotangent of the wall's angle, 0 from 90 degrees up."""
    cotangents = [_ring_cotangents(ring_m) for ring_m in (floorplan.outline_m, *floorplan.holes_m)]
    return np.concatenate(cotangents), np.concatenate([np.roll(c, -1) for c in cotangents])


def _ring_cotangents(ring_m: Array) -> Array:
    forward_m = np.roll(ring_m, -1, axis=0) - ring_m
    before_m = np.roll(forward_m, 1, axis=0)
    cross = before_m[:, 0] * forward_m[:, 1] - before_m[:, 1] * forward_m[:, 0]
    turn_rad = np.arctan2(cross, (before_m * forward_m).sum(axis=1))
    # Free space lies to the left, so the wall's angle at a vertex is pi plus the turn to the left.
    wall_angle_rad = np.maximum(np.pi + turn_rad, 1e-3)
    return np.where(wall_angle_rad < 0.5 * np.pi, 1.0 / np.tan(wall_angle_rad), 0.0)


def _boxes_behind(edges_m: Array, spans: Array) -> tuple[Array, Array]:
    """(N, 4, 2) corners and (N,) lengths [m] of boxes to the right of edges."""
    start_m, step_m = edges_m[:, :2], edges_m[:, 2:] - edges_m[:, :2]
    length_m = np.linalg.norm(step_m, axis=1, keepdims=True)
    along = step_m / length_m
    into_wall = np.stack([along[:, 1], -along[:, 0]], axis=1)
    a = start_m + along * spans[:, 0:1]
    b = start_m + along * (length_m - spans[:, 1:2])
    depth_m = into_wall * spans[:, 2:3]
    return np.stack([a, a + depth_m, b + depth_m, b], axis=1), length_m[:, 0] - spans[:, :2].sum(axis=1)


def _wall_box(edge_m: Array, span: Array, height_m: float) -> Solid:
    corners_m, length_m = _boxes_behind(edge_m[None], span[None])
    x_m, y_m = corners_m[0].mean(axis=0)
    return Solid(
        shape=Shape.BOX,
        x_m=float(x_m),
        y_m=float(y_m),
        yaw_rad=float(np.arctan2(edge_m[3] - edge_m[1], edge_m[2] - edge_m[0])),
        half_x_m=0.5 * float(length_m[0]),
        half_y_m=0.5 * float(span[2]),
        z0_m=0.0,
        z1_m=height_m,
        category="wall",
    )
