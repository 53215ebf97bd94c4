"""What the system is given of a rendezvous, but for the sighting itself."""

from __future__ import annotations

from dataclasses import dataclass, field

from rendezvous.errors import MapError
from rendezvous.fusion.prior import SlamSpread
from rendezvous.geometry.occupancy_grid import OccupancyGrid
from rendezvous.geometry.se2 import SE2


@dataclass(frozen=True, slots=True, kw_only=True)
class Meeting:
    """Two maps, and where their robots stood when robot 0 saw robot 1.

    Attributes:
        grid_0, grid_1: each robot's map; of any size, resolution and origin.
        T_m0_r0, T_m1_r1: each robot's pose in its own map.
        slam: how well both know those poses.
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
