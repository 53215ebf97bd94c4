"""Where the two robots start: in different rooms, out of each other's sight, free to leave."""

from __future__ import annotations

import math
from collections.abc import Sequence

import cv2
import numpy as np
import shapely
from numpy.typing import NDArray

from rendezvous.errors import FloorplanError
from rendezvous.floorplan.records import Floorplan, Shape, Solid
from rendezvous.floorplan.site import largest_component
from rendezvous.geometry.se2 import SE2, Array
from rendezvous.simulation.rays import RayScene, cast_rays

_CELL_M = 0.05
_TRIES = 200


def draw_starts(
    floorplan: Floorplan,
    regions: Sequence[shapely.Polygon],
    solids: Sequence[Solid],
    scene: RayScene,
    *,
    clearance_m: float,
    passage_m: float,
    least_distance_m: float,
    rng: np.random.Generator,
) -> tuple[SE2, SE2]:
    """Two start poses in w.

    Starts keep `clearance_m` from solids and walls, and can reach each other at `passage_m` from them. Two
    rooms are drawn without replacement, then places and headings uniformly.

    Raises:
        FloorplanError: no such pair was found.
    """
    space, corner_m = _open_space(floorplan, solids, clearance_m, passage_m)
    rooms = [_points_in(space, corner_m, region) for region in regions]
    rooms = [points for points in rooms if len(points)]
    if len(rooms) >= 2:
        for _ in range(_TRIES):
            a, b = rng.choice(len(rooms), size=2, replace=False)
            p_0 = rooms[a][rng.integers(len(rooms[a]))]
            p_1 = rooms[b][rng.integers(len(rooms[b]))]
            if math.dist(p_0, p_1) >= least_distance_m and not _in_sight(p_0, p_1, scene):
                yaw_0, yaw_1 = rng.uniform(-math.pi, math.pi, size=2)
                return SE2.from_array([*p_0, yaw_0]), SE2.from_array([*p_1, yaw_1])
    raise FloorplanError(
        f"{floorplan.plan_id}: no two starts in different rooms, {least_distance_m} m apart and out of "
        f"sight, among {len(rooms)} rooms with space to start in"
    )


def _open_space(
    floorplan: Floorplan, solids: Sequence[Solid], clearance_m: float, passage_m: float
) -> tuple[NDArray[np.bool_], Array]:
    """(H, W) bool: cells with that clearance in the largest passable part; and the grid's corner [m]."""
    low_m = floorplan.outline_m.min(axis=0) - 2 * _CELL_M
    high_m = floorplan.outline_m.max(axis=0) + 2 * _CELL_M
    width, height = (math.ceil(n) for n in (high_m - low_m) / _CELL_M)
    image = np.zeros((height, width), np.uint8)
    # Walls drawn a cell wide over the filled rings: a centre beyond the clearance of a drawn cell is safe.
    for value, rings in ((255, [floorplan.outline_m]), (0, floorplan.holes_m)):
        for ring in rings:
            cv2.fillPoly(image, [_pixels(ring, low_m)], value)
    for ring in (floorplan.outline_m, *floorplan.holes_m):
        cv2.polylines(image, [_pixels(ring, low_m)], True, 0)
    for solid in solids:
        if solid.shape is Shape.CYLINDER:
            centre = _pixels(np.array([[solid.x_m, solid.y_m]]), low_m)[0]
            cv2.circle(image, centre.tolist(), math.ceil(solid.half_x_m / _CELL_M), 0, -1)
        else:
            cv2.fillPoly(image, [_pixels(solid.corners_m(), low_m)], 0)
    away_m = cv2.distanceTransform(image, cv2.DIST_L2, 5) * _CELL_M
    passable = (away_m > passage_m).astype(np.uint8)
    return (largest_component(passable) > 0) & (away_m > clearance_m), low_m


def _pixels(p_m: Array, corner_m: Array) -> NDArray[np.int32]:
    return np.floor((p_m - corner_m) / _CELL_M).astype(np.int32)


def _points_in(space: NDArray[np.bool_], corner_m: Array, region: shapely.Polygon) -> Array:
    """(N, 2) [m]: centres of the open cells in the region."""
    mask = np.zeros(space.shape, np.uint8)
    cv2.fillPoly(mask, [_pixels(np.asarray(region.exterior.coords), corner_m)], 1)
    row_col = np.argwhere(space & (mask > 0)).astype(np.float64)
    return corner_m + _CELL_M * (row_col[:, ::-1] + 0.5)


def _in_sight(p_0: Array, p_1: Array, scene: RayScene) -> bool:
    dx, dy = p_1 - p_0
    distance_m = math.hypot(dx, dy)
    pose = np.array([[p_0[0], p_0[1], math.atan2(dy, dx)]])
    return bool(np.isinf(cast_rays(scene, pose, np.zeros(1), max_range_m=distance_m)[0]))
