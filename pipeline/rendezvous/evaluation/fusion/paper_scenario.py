"""The paper's real scenario (Section IV-C), imitated with one of our pairs.

In the paper both maps have 384 x 384 cells of 0.05 m, overlap by 0.174, and T_m0_m1 is (6.0 m, -5.8 m, 180°).
Those maps are not public. The pair of most similar overlap stands in: its frame m1 is chosen so that T_m0_m1
is exactly that, and both maps are drawn on canvases of that size.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from rendezvous.alignment.window import FREE_CELL, OCCUPIED_CELL, WINDOW_CELL_M, WINDOW_CELLS, map_window
from rendezvous.geometry.occupancy_grid import FREE, OCCUPIED, UNKNOWN, OccupancyGrid, overlap
from rendezvous.geometry.se2 import SE2, Array
from rendezvous.training.frame_error.pairs import MapPair

PAPER_OVERLAP = 0.174
T_M0_M1 = SE2(6.0, -5.8, math.pi)

_SIDE_M = WINDOW_CELLS * WINDOW_CELL_M


def scenario(pair: MapPair) -> MapPair | None:
    """The pair with T_m0_m1 as in the paper, on the paper's canvases; None if a map does not fit there."""
    T_a_m1 = T_M0_M1.inverse() @ pair.T_m0_m1  # a: the new frame of map 1
    grid_0 = _on_canvas(pair.grid_0)
    grid_1 = _on_canvas(replace(pair.grid_1, T_m_g=T_a_m1 @ pair.grid_1.T_m_g))
    if grid_0 is None or grid_1 is None:
        return None
    return replace(
        pair,
        grid_0=grid_0,
        grid_1=grid_1,
        T_m0_m1=T_M0_M1,
        T_m1_r1=(T_a_m1 @ pair.T_m1_r1).wrapped(),
        overlap=overlap(grid_0, grid_1, T_M0_M1),
    )


def _on_canvas(grid: OccupancyGrid) -> OccupancyGrid | None:
    """The map in the middle of a canvas with the axes of m; None if it does not fit or is all unknown."""
    points_m = grid.cell_centres(grid.known())
    if not len(points_m):
        return None
    lower_m, upper_m = points_m.min(axis=0), points_m.max(axis=0)
    if (upper_m - lower_m).max() > _SIDE_M - 2.0 * WINDOW_CELL_M:
        return None
    middle = _on_cell_corner(grid, (lower_m + upper_m) / 2.0)
    window = map_window(grid, grid, SE2.identity(), middle).cells[0]
    values = np.full(3, UNKNOWN, np.uint8)
    values[[FREE_CELL, OCCUPIED_CELL]] = FREE, OCCUPIED
    return OccupancyGrid(
        cells=values[window],
        resolution_m=WINDOW_CELL_M,
        T_m_g=middle @ SE2(-0.5 * _SIDE_M, -0.5 * _SIDE_M, 0.0),
    )


def _on_cell_corner(grid: OccupancyGrid, point_m: Array) -> SE2:
    """The corner of a cell near a point (2,), so that the cells of an unrotated map stay as they are."""
    origin_m = grid.T_m_g.as_array()[:2]
    x_m, y_m = origin_m + WINDOW_CELL_M * np.round((point_m - origin_m) / WINDOW_CELL_M)
    return SE2(float(x_m), float(y_m), 0.0)
