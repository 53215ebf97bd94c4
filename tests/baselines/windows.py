"""Windows whose frame error is known: two cuts of one furnished building, and a real pair of maps."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np

from rendezvous.alignment.frame_error import perturbed
from rendezvous.alignment.window import OCCUPIED_CELL, MapWindow, map_window
from rendezvous.geometry.occupancy_grid import UNKNOWN, OccupancyGrid
from rendezvous.geometry.se2 import SE2
from rendezvous.interop.ros_map import read_ros_map
from tests.synthetic import building, cut

REAL_T_M0_M1 = SE2(5.79, -10.58, np.deg2rad(6.0))
"""The registration given with the real pair; no ground truth."""


@cache
def cuts(plan: int) -> tuple[OccupancyGrid, OccupancyGrid, SE2]:
    """Two maps of one building and the true T_m0_m1; they share about a third of what they know."""
    house = building(np.random.default_rng(plan))
    T_w_m0, T_w_m1 = SE2(2.0, 2.0, 0.3), SE2(11.0, 6.0, -2.0)
    along = np.linspace(0.0, 1.0, 40)[:, None]
    meeting = np.array([7.0, 4.5])
    paths = [(1 - along) * start + along * meeting for start in ((2.0, 4.5), (12.0, 4.5))]
    grids = [cut(house, T, path) for T, path in zip((T_w_m0, T_w_m1), paths, strict=True)]
    return grids[0], grids[1], (T_w_m0.inverse() @ T_w_m1).wrapped()


def window_with(theta: SE2, *, plan: int = 0, turn_rad: float = 0.0) -> MapWindow:
    """The window on two cuts whose frame error, in its own axes, is theta."""
    grid_0, grid_1, T_m0_m1 = cuts(plan)
    T_w_m0 = SE2(2.0, 2.0, 0.3)
    T_m0_r1 = T_w_m0.inverse() @ SE2(7.0, 4.5, 0.0)
    return _perturbed_window(grid_0, grid_1, T_m0_m1, T_m0_r1, theta, turn_rad)


def _perturbed_window(
    grid_0: OccupancyGrid,
    grid_1: OccupancyGrid,
    T_m0_m1: SE2,
    T_m0_r1: SE2,
    theta: SE2,
    turn_rad: float,
) -> MapWindow:
    T_c_v = SE2(0.0, 0.0, turn_rad)
    T_estimated, T_m0_c = perturbed(T_m0_m1, T_m0_r1, T_c_v @ theta @ T_c_v.inverse())
    return map_window(grid_0, grid_1, T_estimated, T_m0_c @ T_c_v)


@cache
def real_maps(real_data: Path) -> tuple[OccupancyGrid, OccupancyGrid, SE2]:
    """Both maps and the centroid of their known overlap, in m0."""
    grid_0, grid_1 = (read_ros_map(real_data / "real_pair" / f"map{i}.yaml", strict=False) for i in (1, 2))
    p_m0 = grid_0.cell_centres(grid_0.known())
    shared = p_m0[grid_1.sample(REAL_T_M0_M1.inverse() @ p_m0) != UNKNOWN]
    x_m, y_m = shared.mean(axis=0)
    return grid_0, grid_1, SE2(float(x_m), float(y_m), 0.0)


def real_window(real_data: Path, theta: SE2, *, turn_rad: float = 0.0) -> MapWindow:
    """The window on the real pair whose frame error, by its registration, is theta."""
    grid_0, grid_1, T_m0_centroid = real_maps(real_data)
    return _perturbed_window(grid_0, grid_1, REAL_T_M0_M1, T_m0_centroid, theta, turn_rad)


def without_walls(window: MapWindow, channel: int) -> MapWindow:
    """The same window, every wall of one map made free."""
    cells = window.cells.copy()
    cells[channel][cells[channel] == OCCUPIED_CELL] = 1
    return MapWindow(cells=cells, cell_m=window.cell_m)
