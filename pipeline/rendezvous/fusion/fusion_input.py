"""The input of the system besides the sighting: two maps, and where their robots stood."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from rendezvous.errors import MapError, require_within
from rendezvous.geometry.occupancy_grid import OccupancyGrid
from rendezvous.geometry.se2 import SE2, Array


@dataclass(frozen=True, slots=True, kw_only=True)
class SlamSpread:
    """Standard deviations of each robot's pose in its own map.

    The defaults are about the median error of a lidar SLAM in a building, and what cells of 5 cm allow.
    """

    position_m: float = 0.02
    heading_rad: float = math.radians(0.5)

    def __post_init__(self) -> None:
        require_within(self, position_m=(0.0, 10.0), heading_rad=(0.0, math.pi))

    def covariance(self) -> Array:
        """(3, 3) of x [m], y [m], yaw [rad]."""
        return np.diag([self.position_m**2, self.position_m**2, self.heading_rad**2])


@dataclass(frozen=True, slots=True, kw_only=True)
class FusionInput:
    """Two maps, and where their robots stood when robot 0 saw robot 1.

    Attributes:
        grid_0, grid_1: each robot's map; of any size, resolution and origin.
        T_m0_r0, T_m1_r1: each robot's pose in its own map.
        slam: accuracy of those poses.
    """

    grid_0: OccupancyGrid
    grid_1: OccupancyGrid
    T_m0_r0: SE2
    T_m1_r1: SE2
    slam: SlamSpread = field(default_factory=SlamSpread)

    def __post_init__(self) -> None:
        for number, grid in enumerate((self.grid_0, self.grid_1)):
            if not grid.known().any():
                raise MapError(
                    f"map {number}: none of its {grid.cells.size} cells is known; there is no map to fuse"
                )
