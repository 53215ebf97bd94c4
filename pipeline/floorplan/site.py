"""A floor plan on a grid, and what of it a robot still reaches as furniture comes in.

`reachable` marks where the robot's centre can be: one connected set. A piece is admitted if that set, less
what the piece covers, stays in one piece but for small pockets behind it. Most often a small window around
the piece decides: if all that leaves the window is connected within it, nothing outside is cut off.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import cv2
import numpy as np
import shapely
from numpy.typing import NDArray

from pipeline.floorplan.catalogue import DRIVE_UNDER_M
from pipeline.floorplan.records import Floorplan, Shape, Solid
from pipeline.floorplan.validate import start_regions
from pipeline.geometry.se2 import Array

CELL_M = 0.05

INFLATION_CELLS = 4
"""Cells between an obstacle and the robot's centre: at least 0.165 m, whatever the rounding."""

DOOR_CLEARANCE_M = 0.7
"""Nothing stands this close to the middle of a doorway."""

MAX_POCKET_M2 = 0.3
"""The largest corner that a piece of furniture may cut off, its own footprint not counted."""

MIN_REGION_LEFT = 0.4
"""Of each start region, the share that furniture leaves reachable."""

SHIFT = 4
"""Binary digits of the fractions of a pixel that OpenCV draws with."""

DISC = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * INFLATION_CELLS + 1, 2 * INFLATION_CELLS + 1))

Mask = NDArray[np.uint8]
Window = tuple[slice, slice]


class Site:
    """A floor plan and the furniture that stands in it so far.

    Attributes:
        room_count: rooms, numbered from 1: each start region and what is nearest to it.
        room_of_cell: (H, W) int32, 0 in the walls.
        region_of_cell: (H, W) uint8, the start regions, 0 elsewhere.
        reachable: (H, W) uint8, 1 where the robot's centre can be.
    """

    def __init__(self, floorplan: Floorplan) -> None:
        self.origin_m = floorplan.outline_m.min(axis=0) - 2.0 * CELL_M
        size = np.ceil((floorplan.outline_m.max(axis=0) - self.origin_m) / CELL_M).astype(int) + 2
        self._shape = (int(size[1]), int(size[0]))
        self._everywhere = (slice(0, self._shape[0]), slice(0, self._shape[1]))
        self._free_space = floorplan.free_space()
        shapely.prepare(self._free_space)
        free = self._free_cells(floorplan)
        self.reachable = _largest_component(cv2.erode(free, DISC))
        regions = start_regions(floorplan)
        self.room_count = len(regions)
        self.region_of_cell = np.zeros(self._shape, np.uint8)
        for index, region in enumerate(regions, start=1):
            self._draw(self.region_of_cell, np.asarray(region.exterior.coords), index, self._everywhere)
        self.room_of_cell = _nearest_region(self.region_of_cell) * free
        self._taken = _doorways(self.room_of_cell)
        self._region_left = self._cells_per_region(self.region_of_cell[self.reachable > 0])
        self._region_least = MIN_REGION_LEFT * self._region_left

    def cells_per_room(self) -> list[NDArray[np.int64]]:
        """Per room (N, 2) row, col of its cells."""
        row, col = np.nonzero(self.room_of_cell)
        rooms = self.room_of_cell[row, col]
        order = np.argsort(rooms, kind="stable")
        counts = np.bincount(rooms, minlength=self.room_count + 1)[1:]
        return np.split(np.stack([row, col], axis=1)[order], np.cumsum(counts)[:-1])

    def room_at(self, p_m: Array) -> NDArray[np.int32]:
        """(N,) the rooms of points (N, 2) [m], 0 in the walls."""
        col, row = np.floor((p_m - self.origin_m) / CELL_M).astype(int).T
        return self.room_of_cell[row, col]

    def inside(self, footprints_m: Array) -> NDArray[np.bool_]:
        """(N,) whether footprints (N, 4, 2) [m] lie in the free space wholly."""
        return shapely.covers(self._free_space, shapely.polygons(footprints_m))

    def is_vacant(self, footprint_m: Array) -> bool:
        """Whether a footprint (4, 2) [m] touches no doorway and no other footprint."""
        window = self._window(footprint_m, 0)
        cover = np.zeros(self._taken[window].shape, np.uint8)
        self._draw(cover, footprint_m, 1, window)
        return not (cover & self._taken[window]).any()

    def admit_in_place(self, solids: Sequence[Solid], footprint_m: Array) -> bool:
        """Add a piece, unless it would part what is reachable or fill a start region.

        Args:
            solids: the piece.
            footprint_m: (4, 2) [m] rectangle around it.

        Returns:
            Whether it was added.
        """
        window = self._window(footprint_m, INFLATION_CELLS + 2)
        before = self.reachable[window]
        after = before & (1 - self._covered(solids, window))
        kept = self._kept(after, window)
        if kept is None:
            return False
        own = np.zeros(before.shape, np.uint8)
        self._draw(own, footprint_m, 1, window)
        pockets = after & (1 - kept) & (1 - own)
        if np.count_nonzero(pockets) * CELL_M**2 > MAX_POCKET_M2:
            return False
        lost = self._cells_per_region(self.region_of_cell[window][(before & (1 - kept)) > 0])
        if (self._region_left - lost < self._region_least).any():
            return False
        self._region_left -= lost
        self.reachable[window] = kept
        self._taken[window] |= own
        return True

    def _kept(self, after: Mask, window: Window) -> Mask | None:
        """The window's cells that stay reachable; None if something beyond the window were cut off."""
        _, labels = cv2.connectedComponents(after, connectivity=4)
        rim = np.concatenate([labels[0], labels[-1], labels[:, 0], labels[:, -1]])
        exits = np.unique(rim[rim > 0])
        if len(exits) == 1:
            return (labels == exits[0]).astype(np.uint8)
        # Several ways out of the window may be joined outside.
        everywhere = self.reachable.copy()
        everywhere[window] = after
        largest = _largest_component(everywhere)
        cut_off = everywhere & (1 - largest)
        cut_off[window] = 0
        return None if cut_off.any() else largest[window]

    def _covered(self, solids: Sequence[Solid], window: Window) -> Mask:
        """Where the robot's centre cannot be for what stands on the floor."""
        cover = np.zeros(self.reachable[window].shape, np.uint8)
        for solid in solids:
            if solid.z0_m >= DRIVE_UNDER_M:
                continue
            if solid.shape is Shape.BOX:
                self._draw(cover, solid.corners_m(), 1, window)
            else:
                x_px, y_px = self._pixels(np.array([solid.x_m, solid.y_m]), window).tolist()
                radius_px = math.ceil(solid.half_x_m / CELL_M * 2**SHIFT)
                cv2.circle(cover, (x_px, y_px), radius_px, 1, cv2.FILLED, shift=SHIFT)
        return cv2.dilate(cover, DISC)

    def _free_cells(self, floorplan: Floorplan) -> Mask:
        """Cells that no wall touches."""
        free = np.zeros(self._shape, np.uint8)
        self._draw(free, floorplan.outline_m, 1, self._everywhere)
        for hole_m in floorplan.holes_m:
            self._draw(free, hole_m, 0, self._everywhere)
        rings = [
            self._pixels(ring_m, self._everywhere) for ring_m in (floorplan.outline_m, *floorplan.holes_m)
        ]
        cv2.polylines(free, rings, True, 0, shift=SHIFT)
        return free

    def _cells_per_region(self, regions: Mask) -> NDArray[np.int64]:
        return np.bincount(regions, minlength=self.room_count + 1)[1:]

    def _window(self, footprint_m: Array, margin: int) -> Window:
        """The cells around a footprint, within the grid."""
        low = np.floor((footprint_m.min(axis=0) - self.origin_m) / CELL_M).astype(int) - margin
        high = np.ceil((footprint_m.max(axis=0) - self.origin_m) / CELL_M).astype(int) + margin
        return slice(max(low[1], 0), high[1] + 1), slice(max(low[0], 0), high[0] + 1)

    def _draw(self, cells: Mask, ring_m: Array, value: int, window: Window) -> None:
        cv2.fillPoly(cells, [self._pixels(ring_m, window)], value, shift=SHIFT)

    def _pixels(self, p_m: Array, window: Window) -> NDArray[np.int32]:
        """Points in OpenCV's fixed-point pixels of a window; pixel (0, 0) is the centre of its first cell."""
        first = np.array([window[1].start, window[0].start])
        px = (p_m - self.origin_m) / CELL_M - 0.5 - first
        return np.round(px * 2**SHIFT).astype(np.int32)


def _largest_component(cells: Mask) -> Mask:
    count, labels, stats, _ = cv2.connectedComponentsWithStats(cells, connectivity=4)
    if count < 2:
        return cells
    return (labels == 1 + int(stats[1:, cv2.CC_STAT_AREA].argmax())).astype(np.uint8)


def _nearest_region(region_of_cell: Mask) -> NDArray[np.int32]:
    """(H, W) the region nearest to each cell."""
    source = (region_of_cell == 0).astype(np.uint8)
    _, component = cv2.distanceTransformWithLabels(source, cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_CCOMP)
    region_of_component = np.zeros(int(component.max()) + 1, np.int32)
    marked = region_of_cell > 0
    region_of_component[component[marked]] = region_of_cell[marked]
    return region_of_component[component]


def _doorways(room_of_cell: NDArray[np.int32]) -> Mask:
    """Cells within `DOOR_CLEARANCE_M` of where one room passes into another."""
    inner = np.ones(room_of_cell.shape, np.uint8)
    for axis in (0, 1):
        a = np.swapaxes(room_of_cell, 0, axis)
        between = (a[:-1] != a[1:]) & (a[:-1] > 0) & (a[1:] > 0)
        np.swapaxes(inner, 0, axis)[:-1][between] = 0
    return (cv2.distanceTransform(inner, cv2.DIST_L2, 5) * CELL_M < DOOR_CLEARANCE_M).astype(np.uint8)
