"""Occupancy grids in the values of ROS map_server."""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from rendezvous.errors import MapError
from rendezvous.geometry.se2 import SE2, Array

OCCUPIED, UNKNOWN, FREE = 0, 205, 254  # cell values of ROS map_server's trinary mode
Cells = NDArray[np.uint8]
Mask = NDArray[np.bool_]


@dataclass(frozen=True, slots=True, kw_only=True)
class OccupancyGrid:
    """A trinary occupancy grid.

    Attributes:
        cells: (H, W) uint8 of OCCUPIED, UNKNOWN, FREE; row grows with +y, col with +x of frame g.
        resolution_m: side of a cell [m].
        T_m_g: pose of the outer corner of cell (0, 0) in the map frame m.
    """

    cells: Cells
    resolution_m: float
    T_m_g: SE2

    def __post_init__(self) -> None:
        cells = np.asarray(self.cells)
        if cells.ndim != 2 or cells.dtype != np.uint8:
            raise MapError(f"occupancy grid of shape {cells.shape}, {cells.dtype}; must be (H, W) uint8")
        try:
            resolution_m = float(self.resolution_m)
        except (TypeError, ValueError, OverflowError):
            resolution_m = math.nan
        if not 0.0 < resolution_m < math.inf:
            raise MapError(f"occupancy grid with resolution {self.resolution_m} m; must be positive")
        if not isinstance(self.T_m_g, SE2):
            raise MapError(f"occupancy grid with T_m_g {type(self.T_m_g).__name__}; must be an SE2")
        object.__setattr__(self, "cells", cells)
        object.__setattr__(self, "resolution_m", resolution_m)

    def occupied(self) -> Mask:
        """(H, W) bool."""
        return self.cells == OCCUPIED

    def free(self) -> Mask:
        """(H, W) bool."""
        return self.cells == FREE

    def known(self) -> Mask:
        """(H, W) bool."""
        return self.cells != UNKNOWN

    def cell_centres(self, mask: Mask) -> Array:
        """(N, 2) [m] in m: centres of the mask's cells, row by row."""
        col_row = np.argwhere(mask)[:, ::-1].astype(np.float64)
        return self.T_m_g @ (self.resolution_m * (col_row + 0.5))

    def cell_of(self, p_m: Array) -> NDArray[np.int64]:
        """(N, 2) row, col of the cells that hold points (N, 2) [m] in m; may lie outside the grid."""
        p_g = self.T_m_g.inverse() @ p_m
        return np.floor(p_g[..., ::-1] / self.resolution_m).astype(np.int64)

    def sample(self, p_m: Array) -> Cells:
        """(...,) uint8: the values at points (..., 2) [m] in m; UNKNOWN outside the grid."""
        row_col = self.cell_of(p_m)
        row, col = row_col[..., 0], row_col[..., 1]
        height, width = self.cells.shape
        inside = (row >= 0) & (row < height) & (col >= 0) & (col < width)
        values = self.cells[np.clip(row, 0, height - 1), np.clip(col, 0, width - 1)]
        return np.where(inside, values, np.uint8(UNKNOWN))

    def cropped(self, *, margin_cells: int = 2) -> OccupancyGrid:
        """The part around all known cells; a grid without any keeps one cell."""
        rows = np.flatnonzero(self.known().any(axis=1))
        cols = np.flatnonzero(self.known().any(axis=0))
        if rows.size == 0:
            rows, cols = np.zeros(1, np.int64), np.zeros(1, np.int64)
        height, width = self.cells.shape
        r0, r1 = max(int(rows[0]) - margin_cells, 0), min(int(rows[-1]) + margin_cells + 1, height)
        c0, c1 = max(int(cols[0]) - margin_cells, 0), min(int(cols[-1]) + margin_cells + 1, width)
        T_g_corner = SE2(c0 * self.resolution_m, r0 * self.resolution_m, 0.0)
        return OccupancyGrid(
            cells=self.cells[r0:r1, c0:c1].copy(),
            resolution_m=self.resolution_m,
            T_m_g=self.T_m_g @ T_g_corner,
        )

    def png(self) -> bytes:
        """The grid as a greyscale PNG, top row = largest y."""
        ok, data = cv2.imencode(".png", self.cells[::-1], [cv2.IMWRITE_PNG_COMPRESSION, 6])
        assert ok
        return bytes(data.tobytes())


def grid_from_png(png: bytes, *, resolution_m: float, T_m_g: SE2) -> OccupancyGrid:
    """Inverse of `OccupancyGrid.png`.

    Raises:
        MapError: the bytes are no greyscale image.
    """
    image = cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_UNCHANGED)
    if image is None or image.ndim != 2:
        raise MapError(f"map of {len(png)} bytes is not a greyscale PNG")
    return OccupancyGrid(cells=np.ascontiguousarray(image[::-1]), resolution_m=resolution_m, T_m_g=T_m_g)


def overlap(grid_0: OccupancyGrid, grid_1: OccupancyGrid, T_m0_m1: SE2) -> float:
    """|known_0 ∩ known_1| / |known_0 ∪ known_1|, in [0, 1], sampled at the cells of grid 0.

    0 if neither grid has known cells.
    """
    known_0 = grid_0.known()
    p_m1 = T_m0_m1.inverse() @ grid_0.cell_centres(known_0)
    area_0 = float(known_0.sum()) * grid_0.resolution_m**2
    area_1 = float(grid_1.known().sum()) * grid_1.resolution_m**2
    both = float((grid_1.sample(p_m1) != UNKNOWN).sum()) * grid_0.resolution_m**2
    union = area_0 + area_1 - both
    return both / union if union > 0.0 else 0.0
