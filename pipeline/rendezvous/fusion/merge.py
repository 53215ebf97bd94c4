"""Two maps made one, once the transform between them is known.

`merged` is Algorithm 1 of the paper (Kim, Han & Zhang, 2023): whatever either map calls occupied is occupied.
No wall is lost, so it is the map to plan on; but whatever moved or was mapped wrongly stays as well.
`probabilistically_merged` weighs the maps against each other instead: a wall that the other map saw through
is no longer certain. It removes such ghosts, and with them the parts of a thin wall that the two maps draw
more than a cell apart: use it where the alignment is good to a cell, or to see where maps contradict each
other.

Both lay the maps on one common grid. It has the axes of m0 (yaw 0, whatever the yaw of the grids' origins),
the finer of the two resolutions, a cell corner on the origin of grid 0, and covers both maps wholly.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit

from rendezvous.alignment.window import resampled
from rendezvous.errors import MapError, require_within
from rendezvous.geometry.occupancy_grid import FREE, OCCUPIED, UNKNOWN, OccupancyGrid
from rendezvous.geometry.se2 import SE2, Array

MAX_CELLS = 100_000_000  # largest common grid: 500 m x 500 m at 0.05 m
EDGE_CELLS = 1e-6  # a map that reaches less than this into a cell, by rounding, does not need that cell


class Merging(StrEnum):
    """How two maps become one.

    OCCUPIED: occupied where either map is (Algorithm 1). PROBABILISTIC: by the sum of both maps' log-odds,
    with the weights of `CellEvidence()`.
    """

    OCCUPIED = "occupied"
    PROBABILISTIC = "probabilistic"

    def __call__(self, grid_0: OccupancyGrid, grid_1: OccupancyGrid, T_m0_m1: SE2) -> OccupancyGrid:
        """The global map in m0.

        Raises:
            MapError: the map would have more than `MAX_CELLS` cells.
        """
        if self is Merging.OCCUPIED:
            return merged(grid_0, grid_1, T_m0_m1)
        return probabilistically_merged(grid_0, grid_1, T_m0_m1).grid


def merged(grid_0: OccupancyGrid, grid_1: OccupancyGrid, T_m0_m1: SE2) -> OccupancyGrid:
    """The global map in m0: occupied if either map is, unknown if both are, else free (Algorithm 1).

    Maps of equal size, resolution and origin (yaw 0) under the identity are merged cell by cell.

    Raises:
        MapError: the map would have more than `MAX_CELLS` cells.
    """
    first, second = on_common_grid(grid_0, grid_1, T_m0_m1)
    cells = np.full(first.cells.shape, FREE, np.uint8)
    cells[(first.cells == UNKNOWN) & (second.cells == UNKNOWN)] = UNKNOWN
    cells[(first.cells == OCCUPIED) | (second.cells == OCCUPIED)] = OCCUPIED
    return OccupancyGrid(cells=cells, resolution_m=first.resolution_m, T_m_g=first.T_m_g)


@dataclass(frozen=True, slots=True, kw_only=True)
class CellEvidence:
    """How the cells of trinary maps are weighed.

    The defaults treat both states alike: two maps that contradict each other leave 0.5, which is unknown; two
    that agree leave 0.97 or 0.03. A larger `occupied_probability` makes a wall win over free space: with
    0.95, 'occupied in one, free in the other' is 0.77, occupied.
    """

    occupied_probability: float = 0.85  # that a cell is occupied if one map calls it occupied
    free_probability: float = 0.15  # that a cell is occupied although one map calls it free
    # trust_0, trust_1: factors of each map's log-odds; 0 ignores that map.
    trust_0: float = 1.0
    trust_1: float = 1.0
    # occupied_above, free_below: thresholds on the fused probability, as in ROS.
    occupied_above: float = 0.65
    free_below: float = 0.196

    def __post_init__(self) -> None:
        require_within(self, occupied_probability=(0.5, 0.999), free_probability=(0.001, 0.5))
        require_within(self, trust_0=(0.0, 100.0), trust_1=(0.0, 100.0))
        require_within(self, occupied_above=(self.free_below, 1.0), free_below=(0.0, 1.0))

    def log_odds(self) -> NDArray[np.float32]:
        """(256,) log-odds of being occupied, indexed by a cell's value."""
        values = np.zeros(256, np.float32)
        for value, probability in ((OCCUPIED, self.occupied_probability), (FREE, self.free_probability)):
            values[value] = math.log(probability / (1.0 - probability))
        return values


@dataclass(frozen=True, slots=True, kw_only=True)
class ProbabilisticMerge:
    """A map by weighed evidence."""

    grid: OccupancyGrid  # the trinary map in m0
    occupied_probability: NDArray[np.float32]  # (H, W) float32 of its cells; 0.5 where nothing is known


def probabilistically_merged(
    grid_0: OccupancyGrid, grid_1: OccupancyGrid, T_m0_m1: SE2, evidence: CellEvidence | None = None
) -> ProbabilisticMerge:
    """The global map in m0 by the sum of both maps' log-odds.

    Raises:
        MapError: the map would have more than `MAX_CELLS` cells.
    """
    evidence = evidence or CellEvidence()
    first, second = on_common_grid(grid_0, grid_1, T_m0_m1)
    values = evidence.log_odds()
    log_odds = evidence.trust_0 * values[first.cells] + evidence.trust_1 * values[second.cells]
    probability = expit(log_odds)
    known = (first.cells != UNKNOWN) | (second.cells != UNKNOWN)
    cells = np.full(known.shape, UNKNOWN, np.uint8)
    cells[known & (probability < evidence.free_below)] = FREE
    cells[known & (probability > evidence.occupied_above)] = OCCUPIED
    grid = OccupancyGrid(cells=cells, resolution_m=first.resolution_m, T_m_g=first.T_m_g)
    return ProbabilisticMerge(grid=grid, occupied_probability=probability)


def on_common_grid(
    grid_0: OccupancyGrid, grid_1: OccupancyGrid, T_m0_m1: SE2
) -> tuple[OccupancyGrid, OccupancyGrid]:
    """Both maps in m0 on one grid that covers them wholly, drawn as `resampled` does.

    Raises:
        MapError: the grid would have more than `MAX_CELLS` cells.
    """
    T_m0_g1 = T_m0_m1 @ grid_1.T_m_g
    resolution_m = min(grid_0.resolution_m, grid_1.resolution_m)
    corners_m = np.vstack([_corners(grid_0, grid_0.T_m_g), _corners(grid_1, T_m0_g1)])
    origin_m = grid_0.T_m_g.as_array()[:2]
    corners = (corners_m - origin_m) / resolution_m
    # Python floats overflow to infinity without a warning.
    first_col, first_row = np.floor(corners.min(axis=0) + EDGE_CELLS).tolist()
    last_col, last_row = np.ceil(corners.max(axis=0) - EDGE_CELLS).tolist()
    width, height = last_col - first_col, last_row - first_row
    if not width * height <= MAX_CELLS:
        raise MapError(
            f"the fused map would have {width:.10g} x {height:.10g} cells of {resolution_m:g} m; must be at "
            f"most {MAX_CELLS:,}; map 1 lies at x {T_m0_m1.x_m:g} m, y {T_m0_m1.y_m:g} m in map 0: are the "
            "poses, origins and resolutions right?"
        )
    x_m, y_m = (origin_m + resolution_m * np.array([first_col, first_row])).tolist()
    T_m0_g = SE2(x_m, y_m, 0.0)
    first, second = (
        OccupancyGrid(
            cells=resampled(
                grid.cells,
                (T_m0_source.inverse() @ T_m0_g).as_array(),
                grid.resolution_m,
                resolution_m,
                0.0,
                (int(height), int(width)),
            ),
            resolution_m=resolution_m,
            T_m_g=T_m0_g,
        )
        for grid, T_m0_source in ((grid_0, grid_0.T_m_g), (grid_1, T_m0_g1))
    )
    return first, second


def _corners(grid: OccupancyGrid, T_m0_g: SE2) -> Array:
    """(4, 2) [m] outer corners of a grid in m0."""
    height_m, width_m = (cells * grid.resolution_m for cells in grid.cells.shape)
    return T_m0_g @ np.array([[0.0, 0.0], [width_m, 0.0], [width_m, height_m], [0.0, height_m]])
