"""A floor plan on a grid, and the part that a robot still reaches as furniture is added."""

from __future__ import annotations

import cv2
import numpy as np
import shapely
from numpy.typing import NDArray

from rendezvous.floorplan.reach import (
    DOORWAY,
    VACANT,
    WALL,
    Regions,
    admit_in_place,
    first_vacant,
    furnish_in_place,
)
from rendezvous.floorplan.records import Floorplan, Piece, Shape
from rendezvous.floorplan.validate import start_regions
from rendezvous.geometry.occupancy_grid import Cells
from rendezvous.geometry.se2 import Array

CELL_M = 0.05
MARGIN_CELLS = 5  # cells around the plan, so that a step out through a wall stays on the grid
WALL_SLACK_CELLS = 0.7  # a piece may reach this far into a cell that a wall touches; polygons decide
STEERING_M = 0.065  # room to steer, between a solid and the robot
DOOR_CLEARANCE_M = 0.7  # nothing stands this close to the middle of a doorway
MAX_POCKET_M2 = 0.3  # largest area that a piece of furniture may cut off, besides its own footprint
MIN_REGION_LEFT = 0.4  # share of each start region that furniture leaves reachable
SHIFT = 4  # binary digits of the fractions of a pixel that OpenCV draws with


class Site:
    """A floor plan and the furniture that stands in it so far."""

    def __init__(self, floorplan: Floorplan, *, robot_radius_m: float) -> None:
        self._clearance_m = round(robot_radius_m + STEERING_M, 6)
        self.origin_m = floorplan.outline_m.min(axis=0) - MARGIN_CELLS * CELL_M
        extent_m = np.ptp(floorplan.outline_m, axis=0)
        width, height = (np.ceil(extent_m / CELL_M).astype(int) + 2 * MARGIN_CELLS).tolist()
        self._shape = (height, width)
        self._free_space = floorplan.free_space()
        shapely.prepare(self._free_space)
        free = self._free_cells(floorplan)
        # (H, W) uint8, 1 where the robot's centre can be.
        self.reachable = largest_component(cv2.erode(free, _disc(self._clearance_m)))
        regions = start_regions(floorplan, robot_radius_m=robot_radius_m)
        self.room_count = len(regions)  # rooms, numbered from 1: a start region and the cells nearest to it
        self.region_of_cell = np.zeros(self._shape, np.int32)  # (H, W) the start regions, 0 elsewhere
        for index, region in enumerate(regions, start=1):
            self._draw(self.region_of_cell, np.asarray(region.exterior.coords), index)
        self.room_of_cell = _nearest_region(self.region_of_cell) * free  # (H, W) int32, 0 in the walls
        self._taken = np.where(_doorways(self.room_of_cell), DOORWAY, VACANT).astype(np.uint8)
        self._taken[self.room_of_cell == 0] = WALL
        reached = self.region_of_cell[self.reachable > 0]
        self._region_left = np.bincount(reached, minlength=self.room_count + 1)
        self._region_least = np.ceil(MIN_REGION_LEFT * self._region_left).astype(np.int64)

    def cells_per_room(self) -> list[NDArray[np.int64]]:
        """Per room (N, 2) row, col of every fourth of its cells: enough to draw places from."""
        row, col = np.nonzero(self.room_of_cell[::2, ::2])
        rooms = self.room_of_cell[2 * row, 2 * col]
        order = np.argsort(rooms, kind="stable")
        counts = np.bincount(rooms, minlength=self.room_count + 1)[1:]
        return np.split(2 * np.stack([row, col], axis=1)[order], np.cumsum(counts)[:-1])

    def room_at(self, p_m: Array) -> NDArray[np.int32]:
        """(N,) the rooms of points (N, 2) [m], 0 in the walls."""
        col, row = np.floor((p_m - self.origin_m) / CELL_M).astype(int).T
        return self.room_of_cell[row, col]

    def place_in_place(self, piece: Piece, poses: Array) -> Array | None:
        """Put a piece at the first of these poses (T, 3) at which it fits.

        It fits where its rectangle lies in the free space, clear of doorways and other pieces, and where all
        that the robot reaches stays connected.

        Returns:
            The pose (3,) x [m], y [m], yaw [rad], or None.
        """
        halves_m = np.array([piece.half_x_m, piece.half_y_m])
        rectangles = np.column_stack([self._cells(poses), np.tile(halves_m / CELL_M, (len(poses), 1))])
        n = -1
        while (n := first_vacant(self._taken, rectangles, n + 1, WALL_SLACK_CELLS)) < len(poses):
            corners_m = _corners(poses[n], halves_m)
            if self._free_space.covers(shapely.Polygon(corners_m)) and self._admit(
                piece, poses[n], rectangles[n]
            ):
                furnish_in_place(self._taken, rectangles[n])
                return poses[n]
        return None

    def _admit(self, piece: Piece, pose: Array, rectangle: Array) -> bool:
        boxes = self._cells(piece.standing_at(pose, Shape.BOX))
        cylinders = self._cells(piece.standing_at(pose, Shape.CYLINDER))
        return admit_in_place(
            self.reachable,
            self.region_of_cell,
            self._region_left,
            self._region_least,
            boxes,
            cylinders,
            rectangle,
            self._clearance_m / CELL_M,
            int(MAX_POCKET_M2 / CELL_M**2),
        )

    def _cells(self, poses: Array) -> Array:
        """Rows x [m], y [m], yaw [rad] and maybe half sides [m], in cells."""
        cells = poses / CELL_M
        cells[:, :2] -= self.origin_m / CELL_M
        cells[:, 2] = poses[:, 2]
        return cells

    def _free_cells(self, floorplan: Floorplan) -> Cells:
        """Cells that no wall touches."""
        free = np.zeros(self._shape, np.uint8)
        self._draw(free, floorplan.outline_m, 1)
        for hole_m in floorplan.holes_m:
            self._draw(free, hole_m, 0)
        rings = [self._pixels(ring_m) for ring_m in (floorplan.outline_m, *floorplan.holes_m)]
        cv2.polylines(free, rings, True, 0, shift=SHIFT)
        return free

    def _draw(self, cells: Cells | Regions, ring_m: Array, value: int) -> None:
        cv2.fillPoly(cells, [self._pixels(ring_m)], value, shift=SHIFT)

    def _pixels(self, p_m: Array) -> NDArray[np.int32]:
        """Points in OpenCV's fixed-point pixels; pixel (0, 0) is the centre of the first cell."""
        return np.round(((p_m - self.origin_m) / CELL_M - 0.5) * 2**SHIFT).astype(np.int32)


def _corners(pose: Array, halves_m: Array) -> Array:
    """(4, 2) [m] of a rectangle."""
    cos, sin = np.cos(pose[2]), np.sin(pose[2])
    along, aside = halves_m[0] * np.array([cos, sin]), halves_m[1] * np.array([-sin, cos])
    return pose[:2] + np.array([-along - aside, along - aside, along + aside, aside - along])


def _disc(radius_m: float) -> Cells:
    """Offsets up to this radius [m], as an erosion kernel."""
    reach = int(radius_m / CELL_M)
    offset = np.arange(-reach, reach + 1) * CELL_M
    return (np.hypot(offset[:, None], offset) <= radius_m).astype(np.uint8)


def largest_component(cells: Cells) -> Cells:
    """(H, W) uint8, 1 in the largest 4-connected set of non-zero cells; all 0 if there is none."""
    count, labels, stats, _ = cv2.connectedComponentsWithStats(cells, connectivity=4)
    largest = 1 + int(stats[1:, cv2.CC_STAT_AREA].argmax()) if count > 1 else -1
    return (labels == largest).astype(np.uint8)


def _nearest_region(region_of_cell: Regions) -> Regions:
    """(H, W) the region nearest to each cell."""
    marked = region_of_cell > 0
    source = 1 - marked.astype(np.uint8)
    # A label per cell of the regions, not per connected set of them: regions may touch in a wide doorway.
    _, label = cv2.distanceTransformWithLabels(source, cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL)
    region_of_label = np.zeros(int(label.max()) + 1, np.int32)
    region_of_label[label[marked]] = region_of_cell[marked]
    return region_of_label[label]


def _doorways(room_of_cell: Regions) -> NDArray[np.bool_]:
    """Cells within `DOOR_CLEARANCE_M` of where one room passes into another."""
    inner = np.ones(room_of_cell.shape, np.uint8)
    for axis in (0, 1):
        a = np.swapaxes(room_of_cell, 0, axis)
        between = (a[:-1] != a[1:]) & (a[:-1] > 0) & (a[1:] > 0)
        np.swapaxes(inner, 0, axis)[:-1][between] = 0
    return cv2.distanceTransform(inner, cv2.DIST_L2, 5) * CELL_M < DOOR_CLEARANCE_M
