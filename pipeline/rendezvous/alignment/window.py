"""The window on two maps that an estimator of the frame error looks at.

Both maps are drawn into one square around the meeting point: map 0 as it is, map 1 where the estimate T̃ puts
it. The window's frame is v, its origin in the middle: cell (row, col) of N x N cells has its centre at
`p_v = ((col + 0.5 - N / 2) * cell_m, (row + 0.5 - N / 2) * cell_m)`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import reduce

import numpy as np

from rendezvous.compiled import njit
from rendezvous.geometry.occupancy_grid import FREE, OCCUPIED, UNKNOWN, Cells, Mask, OccupancyGrid
from rendezvous.geometry.se2 import SE2, Array

HIDDEN_CELL, OPEN_CELL, ROBOT_CELL = 0, 1, 2
"""Values of cells: behind a wall or out of range; in sight of the robot; under the robot."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RobotSight:
    """How far a robot sees, and how large it is; the defaults are those of the shipped weights' training."""

    range_m: float = 5.0
    radius_m: float = 0.1


def seen_from(occupied: Mask, robot_m: tuple[float, float], *, cell_m: float, robot: RobotSight) -> Cells:
    """(N, N) uint8: ROBOT_CELL under the robot, OPEN_CELL where it has a line of sight, known or not.

    Each map knows where its own robot stood at the sighting. In the right alignment both robots stand on free
    floor, and neither map has a wall between them.

    The robot is at x, y in the window frame [m]; outside the window nothing is marked.
    """
    out = np.zeros(occupied.shape, np.uint8)
    half = 0.5 * len(occupied)
    col, row = robot_m[0] / cell_m + half, robot_m[1] / cell_m + half
    _look_in_place(out, occupied, col, row, robot.range_m / cell_m, robot.radius_m / cell_m)
    return out


@njit
def _look_in_place(out: Cells, occupied: Mask, col: float, row: float, reach: float, radius: float) -> None:
    """Cast rays in all directions in steps of half a cell; their ends lie less than a cell apart."""
    size = out.shape[0]
    if not (0.0 <= col < size and 0.0 <= row < size):
        return
    rays = math.ceil(2.0 * math.pi * reach)
    for ray in range(rays):
        c, s = math.cos(2.0 * math.pi * ray / rays), math.sin(2.0 * math.pi * ray / rays)
        for step in range(math.floor(2.0 * reach) + 1):
            x, y = col + 0.5 * step * c, row + 0.5 * step * s
            if not (0.0 <= x < size and 0.0 <= y < size):
                break
            if 0.5 * step > radius and occupied[int(y), int(x)]:
                break
            out[int(y), int(x)] = OPEN_CELL
    for y in range(max(0, math.floor(row - radius)), min(size, math.ceil(row + radius))):
        for x in range(max(0, math.floor(col - radius)), min(size, math.ceil(col + radius))):
            if math.hypot(x + 0.5 - col, y + 0.5 - row) <= radius:
                out[y, x] = ROBOT_CELL


@njit
def resampled(
    source: Cells, T_s_g: Array, source_m: float, cell_m: float, corner_m: float, shape: tuple[int, int]
) -> Cells:
    """(H, W) uint8: the source's cells on another grid g.

    Each cell takes the source cell that its centre lies in, unknown outside. A turned wall of one cell can
    slip between all centres, so every occupied source cell also marks the cell that its own centre lies in.

    `T_s_g` (3,) is the pose of g in the frame s of the source's outer corner: x [m], y [m], yaw [rad]. Cells
    have sides of `source_m` and `cell_m`; cell (0, 0) of g has its outer corner at x = y = `corner_m`.
    """
    (height, width), (rows, cols) = source.shape, shape
    c, s = math.cos(T_s_g[2]), math.sin(T_s_g[2])
    out = np.full(shape, UNKNOWN, np.uint8)
    # Cell to source cell: col_s = x0 + ux * col - uy * row, row_s = y0 + uy * col + ux * row.
    ux, uy = c * cell_m / source_m, s * cell_m / source_m
    first_m = 0.5 * cell_m + corner_m
    x0 = (T_s_g[0] + (c - s) * first_m) / source_m
    y0 = (T_s_g[1] + (s + c) * first_m) / source_m
    for row in range(rows):
        for col in range(cols):
            col_s = math.floor(x0 + ux * col - uy * row)
            row_s = math.floor(y0 + uy * col + ux * row)
            if 0 <= row_s < height and 0 <= col_s < width:
                out[row, col] = source[row_s, col_s]
    for row_s in range(height):
        for col_s in range(width):
            if source[row_s, col_s] == OCCUPIED:
                x_m = (col_s + 0.5) * source_m - T_s_g[0]
                y_m = (row_s + 0.5) * source_m - T_s_g[1]
                col = math.floor((c * x_m + s * y_m - corner_m) / cell_m)
                row = math.floor((c * y_m - s * x_m - corner_m) / cell_m)
                if 0 <= row < rows and 0 <= col < cols:
                    out[row, col] = OCCUPIED
    return out


UNKNOWN_CELL, FREE_CELL, OCCUPIED_CELL = 0, 1, 2
"""Values of a window's cells. Where several fall into one cell, the largest wins."""
_CODES = np.zeros(256, np.uint8)
_CODES[[FREE, OCCUPIED]] = FREE_CELL, OCCUPIED_CELL

WINDOW_CELLS, WINDOW_CELL_M = 384, 0.05  # the paper's window: 19.2 m across
PAPER_XY_M, PAPER_YAW_RAD = 2.0, math.pi / 4.0
"""The range of frame errors, ±2 m, ±2 m, ±45°. The paper does not state it: it is inferred from the row of
its Table I that failed to learn (0.999 m, 0.964 m, 0.394 rad), which are the means of a uniform
distribution."""


@dataclass(frozen=True, slots=True, kw_only=True)
class MapWindow:
    """Both maps around the meeting point.

    Attributes:
        cells: (2, N, N) uint8 of UNKNOWN_CELL, FREE_CELL, OCCUPIED_CELL; channel 0 is map 0, channel 1 map 1
            as the estimate places it; row grows with +y, col with +x of v.
        cell_m: side of a cell [m].
        sight: (2, N, N) uint8 of `seen_from`'s cells: in each map its robot at the time of the sighting
            and what that robot sees. Robot 1 stands in the middle. None without a sighting.
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
        """The window in cells `factor` times as wide; occupied wins, then free, then unknown."""
        size = self.cells.shape[1]
        assert size % factor == 0, f"{size} cells cannot be pooled by {factor}"
        return MapWindow(
            cells=_pooled(self.cells, factor),
            cell_m=factor * self.cell_m,
            sight=None if self.sight is None else _pooled(self.sight, factor),
        )

    def without_sight(self) -> MapWindow:
        """The maps alone."""
        return replace(self, sight=None)


def _pooled(cells: Cells, factor: int) -> Cells:
    """The largest value in each block."""
    strips = reduce(np.maximum, (cells[:, row::factor] for row in range(factor)))
    return reduce(np.maximum, (strips[:, :, col::factor] for col in range(factor)))


@dataclass(frozen=True, slots=True, kw_only=True)
class SearchRange:
    """Half widths of a search for the frame error, in the axes of v."""

    xy_m: float
    yaw_rad: float

    @staticmethod
    def covering(*, xy_m: float, yaw_rad: float) -> SearchRange:
        """The search that reaches every frame error of |x|, |y| <= xy_m in a window of any heading."""
        return SearchRange(xy_m=math.sqrt(2.0) * xy_m, yaw_rad=yaw_rad)


DEFAULT_SEARCH = SearchRange.covering(xy_m=PAPER_XY_M, yaw_rad=PAPER_YAW_RAD)  # covers the paper's range


def map_window(
    grid_0: OccupancyGrid,
    grid_1: OccupancyGrid,
    T_m0_m1: SE2,
    T_m0_v: SE2,
    *,
    T_m0_r0: SE2 | None = None,
    cells: int = WINDOW_CELLS,
    cell_m: float = WINDOW_CELL_M,
    robot: RobotSight | None = None,
) -> MapWindow:
    """Draw both maps into one window, as `resampled` does.

    Args:
        grid_0, grid_1: the maps, of any size and resolution.
        T_m0_m1: where to put map 1.
        T_m0_v: the window's centre and axes; with a sighting, the centre is where T_m0_m1 puts robot 1.
        T_m0_r0: robot 0's pose when it saw robot 1; None for a window without a sighting.
        cells: cells along a side, N.
        cell_m: side of a cell [m].
        robot: range and radius of both robots; by default `RobotSight()`.
    """
    corner_m = -0.5 * cells * cell_m
    channels = np.empty((2, cells, cells), np.uint8)
    for channel, grid, T_m_v in (
        (channels[0], grid_0, T_m0_v),
        (channels[1], grid_1, T_m0_m1.inverse() @ T_m0_v),
    ):
        T_g_v = (grid.T_m_g.inverse() @ T_m_v).as_array()
        source = np.ascontiguousarray(grid.cells)
        channel[:] = _CODES[resampled(source, T_g_v, grid.resolution_m, cell_m, corner_m, (cells, cells))]
    if T_m0_r0 is None:
        return MapWindow(cells=channels, cell_m=cell_m)
    T_v_r0 = T_m0_v.inverse() @ T_m0_r0
    robots_m = (T_v_r0.x_m, T_v_r0.y_m), (0.0, 0.0)
    sight = [
        seen_from(channel == OCCUPIED_CELL, robot_m, cell_m=cell_m, robot=robot or RobotSight())
        for channel, robot_m in zip(channels, robots_m, strict=True)
    ]
    return MapWindow(cells=channels, cell_m=cell_m, sight=np.stack(sight))
