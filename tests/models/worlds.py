"""Maps and pairs of maps with a known frame error."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from rendezvous.alignment.frame_error import perturbed
from rendezvous.alignment.window import MapWindow, map_window
from rendezvous.geometry.occupancy_grid import FREE, OCCUPIED, UNKNOWN, OccupancyGrid
from rendezvous.geometry.se2 import SE2


def rooms(rng: np.random.Generator, *, cells: int = 160, resolution_m: float = 0.1) -> OccupancyGrid:
    """A block of free space with walls, like no turned or shifted copy of itself; m0 lies at its centre."""
    values = np.full((cells, cells), UNKNOWN, np.uint8)
    low, high = cells // 5, cells - cells // 5
    values[low:high, low:high] = FREE
    values[[low, low + 1, high - 1, high], low:high] = OCCUPIED
    # Uniform: where each wall starts, which way and how far it runs.
    for row, col, length in rng.integers(low, high - 10, (8, 3)):
        end = min(high, row + length // 2), min(high, col + length // 2)
        if rng.random() < 0.5:
            values[row : end[0], col : col + 2] = OCCUPIED
        else:
            values[row : row + 2, col : end[1]] = OCCUPIED
    half_m = 0.5 * cells * resolution_m
    return OccupancyGrid(cells=values, resolution_m=resolution_m, T_m_g=SE2(-half_m, -half_m, 0.0))


def misplaced(grid: OccupancyGrid, theta: SE2, *, cells: int, cell_m: float) -> MapWindow:
    """The window on a map and the same map misplaced by a frame error."""
    T_m0_m1, T_m0_v = perturbed(SE2.identity(), SE2(0.4, -0.7, 0.0), theta)
    return map_window(grid, grid, T_m0_m1, T_m0_v, cells=cells, cell_m=cell_m)


def batch(count: int, *, cells: int, cell_m: float, seed: int = 0) -> tuple[Tensor, Tensor]:
    """(B, 2, N, N) uint8 cells and (B, 3) float32 frame errors, uniform in ±2 m, ±2 m, ±π/4."""
    rng = np.random.default_rng(seed)
    theta_B3 = rng.uniform(-1.0, 1.0, (count, 3)) * [2.0, 2.0, np.pi / 4]
    windows = [
        misplaced(rooms(rng), SE2.from_array(theta), cells=cells, cell_m=cell_m).cells for theta in theta_B3
    ]
    return torch.from_numpy(np.stack(windows)), torch.from_numpy(theta_B3).float()
