"""Maps cut to what a robot explored in a short visit."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from rendezvous.errors import ConfigError
from rendezvous.geometry.occupancy_grid import FREE, OCCUPIED, UNKNOWN, OccupancyGrid
from rendezvous.geometry.se2 import SE2
from rendezvous.training.frame_error.pairs import MapPair
from rendezvous.training.frame_error.short_visits import ShortVisits, explored_part, of_short_visits

CELL_M = 0.05


def _grid(cells: np.ndarray) -> OccupancyGrid:
    half_m = 0.5 * CELL_M * len(cells)
    return OccupancyGrid(cells=cells.astype(np.uint8), resolution_m=CELL_M, T_m_g=SE2(-half_m, -half_m, 0.0))


def _two_rooms() -> OccupancyGrid:
    """8 m x 8 m of floor; a wall at x = 0 with a door at its upper end."""
    cells = np.full((160, 160), FREE)
    cells[:140, 80] = OCCUPIED
    return _grid(cells)


def _known_m(grid: OccupancyGrid) -> np.ndarray:
    return grid.cell_centres(grid.known())


def test_the_part_holds_the_robot_and_reaches_no_farther_than_it_may():
    open_floor = _grid(np.full((160, 160), FREE))
    for seed in range(5):
        part = explored_part(open_floor, SE2(1.0, 0.5, 0.3), reach_m=1.5, rng=np.random.default_rng(seed))
        known = _known_m(part)
        assert part.sample(np.array([1.0, 0.5])) == FREE
        across_m = np.ptp(known, axis=0)
        assert (across_m > 2.0 * 1.5 * 0.9).all()
        assert (across_m < 2.0 * 1.5 + 0.6).all()
        assert 0.85 < len(known) * CELL_M**2 / (math.pi * 1.65**2) < 1.25


def test_the_way_leads_along_the_floor_and_walls_beside_it_are_kept():
    grid = _two_rooms()
    part = explored_part(grid, SE2(-1.0, -3.0, 0.0), reach_m=2.0, rng=np.random.default_rng(0))
    known = _known_m(part)
    assert (known[:, 0] < 0.2).all()  # the other room is 7 m away
    assert part.occupied().sum() > 20
    assert (part.cells[part.known()] == grid.cells[part.known()]).all()
    through = explored_part(grid, SE2(-1.0, -3.0, 0.0), reach_m=30.0, rng=np.random.default_rng(0))
    assert (through.cells == grid.cells).all()


def test_a_robot_off_its_floor_keeps_its_map():
    grid = _grid(np.full((40, 40), UNKNOWN))
    assert explored_part(grid, SE2.identity(), reach_m=2.0, rng=np.random.default_rng(0)) is grid
    grid = _two_rooms()
    assert explored_part(grid, SE2(9.0, 0.0, 0.0), reach_m=2.0, rng=np.random.default_rng(0)) is grid


def test_overlap_is_drawn_whatever_it_was_and_the_label_stays():
    grid = _two_rooms()
    pair = MapPair(
        pair_id="p", grid_0=grid, grid_1=grid, overlap=1.0, T_m0_m1=SE2.identity(),
        T_m0_r0=SE2(-2.0, -1.0, 0.0), T_m1_r1=SE2(-1.0, -2.0, 0.0),
    )  # fmt: skip
    cut = [of_short_visits(pair, ShortVisits(), np.random.default_rng(seed)) for seed in range(12)]
    overlaps = [one.overlap for one in cut]
    assert min(overlaps) < 0.3
    assert max(overlaps) > 0.6
    assert all(replace(one, grid_0=grid, grid_1=grid, overlap=1.0) == pair for one in cut)
    again = of_short_visits(pair, ShortVisits(), np.random.default_rng(3))
    assert (again.grid_0.cells == cut[3].grid_0.cells).all()
    assert (again.grid_1.cells == cut[3].grid_1.cells).all()


def test_a_reach_that_falls_is_refused():
    with pytest.raises(ConfigError, match=r"reach_m is \[8.0, 2.0\]; must rise"):
        ShortVisits(reach_m=(8.0, 2.0))
