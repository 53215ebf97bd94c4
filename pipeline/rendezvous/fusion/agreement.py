"""How well a fused map agrees with the true one, and two maps with each other."""

from __future__ import annotations

from dataclasses import dataclass

from rendezvous.geometry.occupancy_grid import FREE, OCCUPIED, UNKNOWN, OccupancyGrid
from rendezvous.geometry.se2 import SE2
from rendezvous.geometry.wall_agreement import count_near, wall_agreement


@dataclass(frozen=True, slots=True, kw_only=True)
class Agreement:
    """How the occupied cells of two maps in one frame coincide within a tolerance.

    Attributes:
        occupied_a, occupied_b: occupied cells of each map.
        near_a: those of a within the tolerance of an occupied cell of b.
        near_b: those of b within the tolerance of an occupied cell of a.
    """

    occupied_a: int
    occupied_b: int
    near_a: int
    near_b: int

    @property
    def iou(self) -> float | None:
        """Intersection over union in [0, 1]; None for two maps without occupied cells.

        A cell with a partner within the tolerance is in both maps: the intersection is
        `(near_a + near_b) / 2`, the union all cells less that. With tolerance 0 on one grid this is the
        intersection over union of the two sets of cells. Maps of different resolution count cells of
        different size; compare those by `share_a` and `share_b`.
        """
        both = 0.5 * (self.near_a + self.near_b)
        union = self.occupied_a + self.occupied_b - both
        return both / union if union else None

    @property
    def share_a(self) -> float | None:
        """near_a / occupied_a: how much of map a is in b; None for a map without occupied cells."""
        return self.near_a / self.occupied_a if self.occupied_a else None

    @property
    def share_b(self) -> float | None:
        """near_b / occupied_b: how much of map b is in a; None for a map without occupied cells."""
        return self.near_b / self.occupied_b if self.occupied_b else None


def agreement(grid_a: OccupancyGrid, grid_b: OccupancyGrid, tolerance_m: float) -> Agreement:
    """Compare the occupied cells of two maps in one frame, of any size, resolution and origin.

    Distances are between centres of cells: a tolerance of one cell's side reaches a cell's four neighbours,
    not the diagonal ones.
    """
    walls_a, walls_b = grid_a.cell_centres(grid_a.occupied()), grid_b.cell_centres(grid_b.occupied())
    return Agreement(
        occupied_a=len(walls_a),
        occupied_b=len(walls_b),
        near_a=count_near(walls_a, walls_b, tolerance_m),
        near_b=count_near(walls_b, walls_a, tolerance_m),
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class MapAgreement:
    """How two maps agree where both are known; each figure counts cells of both maps.

    Attributes:
        wall_share: of the occupied cells in the other map's known area, the share within the tolerance of an
            occupied cell there; None where there are none.
        conflict_share: of the cells in the other map's known area, the share where one map says occupied and
            the other free: 1 minus the acceptance index of Carpin (2008). None where nothing is known in
            both.
        compared: number of cells behind `wall_share`.
        known_in_both: number of cells behind `conflict_share`.
    """

    wall_share: float | None
    conflict_share: float | None
    compared: int
    known_in_both: int


def map_agreement(
    grid_0: OccupancyGrid, grid_1: OccupancyGrid, T_m0_m1: SE2, *, tolerance_m: float = 0.10
) -> MapAgreement:
    """Compare two maps where both are known, with map 1 placed by `T_m0_m1`; symmetric in the maps."""
    walls = wall_agreement(grid_0, grid_1, T_m0_m1, tolerance_m=tolerance_m)
    there = _conflicts(grid_0, grid_1, T_m0_m1.inverse())
    back = _conflicts(grid_1, grid_0, T_m0_m1)
    known_in_both = there[0] + back[0]
    return MapAgreement(
        wall_share=walls.share,
        conflict_share=(there[1] + back[1]) / known_in_both if known_in_both else None,
        compared=walls.compared,
        known_in_both=known_in_both,
    )


def _conflicts(grid_a: OccupancyGrid, grid_b: OccupancyGrid, T_b_a: SE2) -> tuple[int, int]:
    """Number of a's cells that are known in both maps, and of those on which the maps contradict each
    other."""
    known_a = grid_a.known()
    values_a = grid_a.cells[known_a]
    values_b = grid_b.sample(T_b_a @ grid_a.cell_centres(known_a))
    conflict = ((values_a == OCCUPIED) & (values_b == FREE)) | ((values_a == FREE) & (values_b == OCCUPIED))
    return int((values_b != UNKNOWN).sum()), int(conflict.sum())
