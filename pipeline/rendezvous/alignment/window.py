"""The window on two maps that an estimator of the frame error looks at.

Both maps are drawn into one square around the meeting point: map 0 as it is, map 1 where the estimate T̃ puts
it. Cell (row, col) of a window of N x N cells has its centre at `((col + 0.5 - N / 2) * cell_m,
(row + 0.5 - N / 2) * cell_m)` in the window frame w.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import reduce

import numpy as np

from rendezvous.alignment.sight import seen_from
from rendezvous.compiled import njit
from rendezvous.geometry.occupancy_grid import FREE, OCCUPIED, Cells, OccupancyGrid
from rendezvous.geometry.se2 import SE2, Array

UNKNOWN_CELL, FREE_CELL, OCCUPIED_CELL = 0, 1, 2
"""Values of a window's cells. Where several fall into one, the largest wins."""

WINDOW_CELLS, WINDOW_CELL_M = 384, 0.05
"""The paper's window: 19.2 m across."""


@dataclass(frozen=True, slots=True, kw_only=True)
class MapWindow:
    """Both maps around the meeting point.

    Attributes:
        cells: (2, N, N) uint8 of UNKNOWN_CELL, FREE_CELL, OCCUPIED_CELL; channel 0 is map 0, channel 1 map 1
            as the estimate places it; row grows with +y, col with +x of w.
        cell_m: side of a cell [m].
        sight: (2, N, N) uint8 of `alignment.sight`'s cells: in each map the robot that stood there when one
            saw the other, and what lies open before it. Robot 1 stands in the middle. None if the maps are
            not of a sighting, or it is not to be used.
    """

    cells: Cells
    cell_m: float
    sight: Cells | None = None

    def __post_init__(self) -> None:
        size = self.cells.shape[-1]
        assert self.cells.shape == (2, size, size), self.cells.shape
        assert self.cells.dtype == np.uint8, self.cells.dtype
        assert self.sight is None or self.sight.shape == self.cells.shape, self.sight.shape
        assert self.cell_m > 0.0, self.cell_m

    def pooled(self, factor: int) -> MapWindow:
        """The same window in cells that many times coarser; occupied wins, then free, then unknown."""
        size = self.cells.shape[1]
        assert size % factor == 0, f"{size} cells cannot be pooled by {factor}"
        return MapWindow(
            cells=_pooled(self.cells, factor),
            cell_m=factor * self.cell_m,
            sight=None if self.sight is None else _pooled(self.sight, factor),
        )

    def of_maps_alone(self) -> MapWindow:
        """The same window without where the robots stood."""
        return replace(self, sight=None)


def _pooled(cells: Cells, factor: int) -> Cells:
    """The largest value in each block."""
    strips = reduce(np.maximum, (cells[:, row::factor] for row in range(factor)))
    return reduce(np.maximum, (strips[:, :, col::factor] for col in range(factor)))


@dataclass(frozen=True, slots=True, kw_only=True)
class SearchRange:
    """Half widths of a search for the frame error, in the axes of w."""

    xy_m: float
    yaw_rad: float

    @staticmethod
    def covering(*, xy_m: float, yaw_rad: float) -> SearchRange:
        """The search that reaches every frame error of |x|, |y| <= xy_m in a window turned at random."""
        return SearchRange(xy_m=math.sqrt(2.0) * xy_m, yaw_rad=yaw_rad)


DEFAULT_SEARCH = SearchRange.covering(xy_m=2.0, yaw_rad=math.pi / 4)
"""Covers frame errors of ±2 m, ±2 m, ±π/4: the paper's range, as far as its table lets one infer it."""


def map_window(
    grid_0: OccupancyGrid,
    grid_1: OccupancyGrid,
    T_m0_m1: SE2,
    T_m0_w: SE2,
    *,
    T_m0_r0: SE2 | None = None,
    cells: int = WINDOW_CELLS,
    cell_m: float = WINDOW_CELL_M,
) -> MapWindow:
    """Draw both maps into one window.

    A cell takes what the map holds at its centre; every occupied cell of the map is drawn as well where its
    own centre falls, so that no wall is lost to a turned or a coarser window.

    Args:
        grid_0, grid_1: the maps, of any size and resolution.
        T_m0_m1: where to put map 1.
        T_m0_w: the window's centre and axes; where there is a sighting, the centre is where T_m0_m1 puts the
            robot that was seen.
        T_m0_r0: where robot 0 stood when it saw robot 1; None: the window tells nothing of a sighting.
        cells: cells along a side, N.
        cell_m: side of a cell [m].
    """
    channels = np.empty((2, cells, cells), np.uint8)
    for channel, grid, T_m_w in (
        (channels[0], grid_0, T_m0_w),
        (channels[1], grid_1, T_m0_m1.inverse() @ T_m0_w),
    ):
        T_g_w = (grid.T_m_g.inverse() @ T_m_w).as_array()
        _draw_in_place(channel, np.ascontiguousarray(grid.cells), T_g_w, cell_m, grid.resolution_m)
    if T_m0_r0 is None:
        return MapWindow(cells=channels, cell_m=cell_m)
    T_w_r0 = T_m0_w.inverse() @ T_m0_r0
    robots_m = (T_w_r0.x_m, T_w_r0.y_m), (0.0, 0.0)
    sight = [
        seen_from(channel == OCCUPIED_CELL, robot_m, cell_m=cell_m)
        for channel, robot_m in zip(channels, robots_m, strict=True)
    ]
    return MapWindow(cells=channels, cell_m=cell_m, sight=np.stack(sight))


@njit
def _draw_in_place(out: Cells, source: Cells, T_g_w: Array, cell_m: float, resolution_m: float) -> None:
    size, (height, width) = out.shape[0], source.shape
    c, s = math.cos(T_g_w[2]), math.sin(T_g_w[2])
    half_m = 0.5 * size * cell_m
    # Window cell to source cell: col_g = x0 + ux * col - uy * row, row_g = y0 + uy * col + ux * row.
    ux, uy = c * cell_m / resolution_m, s * cell_m / resolution_m
    first_m = 0.5 * cell_m - half_m
    x0 = (T_g_w[0] + (c - s) * first_m) / resolution_m
    y0 = (T_g_w[1] + (s + c) * first_m) / resolution_m
    for row in range(size):
        for col in range(size):
            col_g = math.floor(x0 + ux * col - uy * row)
            row_g = math.floor(y0 + uy * col + ux * row)
            value = UNKNOWN_CELL
            if 0 <= row_g < height and 0 <= col_g < width:
                cell = source[row_g, col_g]
                value = OCCUPIED_CELL if cell == OCCUPIED else FREE_CELL if cell == FREE else UNKNOWN_CELL
            out[row, col] = value
    for row_g in range(height):
        for col_g in range(width):
            if source[row_g, col_g] != OCCUPIED:
                continue
            x_m = (col_g + 0.5) * resolution_m - T_g_w[0]
            y_m = (row_g + 0.5) * resolution_m - T_g_w[1]
            col = math.floor((c * x_m + s * y_m + half_m) / cell_m)
            row = math.floor((c * y_m - s * x_m + half_m) / cell_m)
            if 0 <= row < size and 0 <= col < size:
                out[row, col] = OCCUPIED_CELL
