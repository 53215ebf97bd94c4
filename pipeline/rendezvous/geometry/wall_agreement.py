"""Agreement of the walls of two maps."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from rendezvous.geometry.occupancy_grid import UNKNOWN, OccupancyGrid
from rendezvous.geometry.se2 import SE2, Array


@dataclass(frozen=True, slots=True, kw_only=True)
class WallAgreement:
    """How the occupied cells of two aligned maps coincide."""

    compared: int  # occupied cells of either map that lie in the other's known area
    near: int  # those among them with an occupied cell of the other map within the tolerance

    @property
    def share(self) -> float | None:
        """near / compared, in [0, 1]; None where nothing could be compared."""
        return self.near / self.compared if self.compared else None


def wall_agreement(
    grid_0: OccupancyGrid, grid_1: OccupancyGrid, T_m0_m1: SE2, *, tolerance_m: float = 0.10
) -> WallAgreement:
    """Compare the walls of two maps, each with the other, with grid 1 placed by `T_m0_m1`.

    A cell stands for its centre; distances are between centres, not rounded to cells.
    """
    there = _one_way(grid_0, grid_1, T_m0_m1.inverse(), tolerance_m)
    back = _one_way(grid_1, grid_0, T_m0_m1, tolerance_m)
    return WallAgreement(compared=there[0] + back[0], near=there[1] + back[1])


def _one_way(grid_a: OccupancyGrid, grid_b: OccupancyGrid, T_b_a: SE2, tolerance_m: float) -> tuple[int, int]:
    walls_b = T_b_a @ grid_a.cell_centres(grid_a.occupied())
    compared = walls_b[grid_b.sample(walls_b) != UNKNOWN]
    return len(compared), count_near(compared, grid_b.cell_centres(grid_b.occupied()), tolerance_m)


def count_near(points_m: Array, targets_m: Array, tolerance_m: float) -> int:
    """How many of points (N, 2) [m] have one of targets (M, 2) [m] within the tolerance, itself included."""
    return int(np.isfinite(nearest_m(points_m, targets_m, within_m=tolerance_m)).sum())


def nearest_m(points_m: Array, targets_m: Array, *, within_m: float) -> Array:
    """(N,) distance [m] from points (N, 2) to the nearest target (M, 2); infinite beyond `within_m`."""
    if not len(points_m) or not len(targets_m):
        return np.full(len(points_m), np.inf)
    # cKDTree's bound is exclusive; the nanometre keeps cells exactly this far apart whatever the rounding.
    distance_m: Array = cKDTree(targets_m).query(points_m, distance_upper_bound=within_m + 1e-9)[0]
    return distance_m
