import math

import numpy as np
import pytest
from pytest import approx
from rendezvous.alignment.frame_error import perturbed
from rendezvous.alignment.window import (
    FREE_CELL,
    OCCUPIED_CELL,
    UNKNOWN_CELL,
    MapWindow,
    SearchRange,
    map_window,
)
from rendezvous.geometry.occupancy_grid import FREE, OCCUPIED, UNKNOWN, OccupancyGrid
from rendezvous.geometry.se2 import SE2, Array

WINDOW_VALUE = {UNKNOWN: UNKNOWN_CELL, FREE: FREE_CELL, OCCUPIED: OCCUPIED_CELL}


def speckled(seed: int, *, resolution_m: float = 0.05, T_m_g: SE2 | None = None) -> OccupancyGrid:
    """A grid of which every cell is drawn at random: most are free, some occupied or unknown."""
    values = np.array([OCCUPIED, UNKNOWN, FREE], np.uint8)
    cells = np.random.default_rng(seed).choice(values, size=(70, 90), p=[0.1, 0.2, 0.7])
    return OccupancyGrid(cells=cells, resolution_m=resolution_m, T_m_g=T_m_g or SE2(-2.0, -1.5, 0.2))


def centres(window: MapWindow) -> Array:
    """(N, N, 2) [m] in w, as the module's docstring says."""
    size = window.cells.shape[1]
    row, col = np.mgrid[:size, :size]
    return np.stack([col + 0.5 - size / 2, row + 0.5 - size / 2], axis=-1) * window.cell_m


def test_window_along_the_cells_shows_the_grid_itself():
    grid = speckled(0, T_m_g=SE2(-2.0, -1.5, 0.0))
    window = map_window(grid, grid, SE2.identity(), SE2(0.5, 0.25, 0.0), cells=40, cell_m=0.05)
    shown = grid.cells[
        15:55, 30:70
    ]  # from (-0.5, -0.75) m on, which is 30 columns and 15 rows from the corner
    expected = np.vectorize(WINDOW_VALUE.get)(shown)
    np.testing.assert_array_equal(window.cells[0], expected)
    np.testing.assert_array_equal(window.cells[1], expected)


def test_every_cell_shows_the_grid_at_its_centre_unless_a_wall_was_drawn_over_it():
    grid_0, grid_1 = speckled(1), speckled(2, T_m_g=SE2(-1.0, -2.0, -0.4))
    T_m0_m1, T_m0_v = SE2(0.4, -0.3, 1.1), SE2(0.2, 0.1, 0.7)
    window = map_window(grid_0, grid_1, T_m0_m1, T_m0_v, cells=64, cell_m=0.06)
    p_m0 = T_m0_v @ centres(window)
    sampled = [grid_0.sample(p_m0), grid_1.sample(T_m0_m1.inverse() @ p_m0)]
    for shown, values in zip(window.cells, sampled, strict=True):
        differs = shown != np.vectorize(WINDOW_VALUE.get)(values)
        assert (shown[differs] == OCCUPIED_CELL).all()
        assert (shown[values == OCCUPIED] == OCCUPIED_CELL).all()
        assert 0 < differs.mean() < 0.1


@pytest.mark.parametrize("cell_m", [0.03, 0.05, 0.1, 0.2])
@pytest.mark.parametrize("turn_rad", [0.0, 0.3, math.pi / 4, 2.0, -2.9])
def test_no_wall_is_lost(cell_m: float, turn_rad: float):
    grid = speckled(3)
    T_m0_v = SE2(0.1, 0.2, turn_rad)
    window = map_window(grid, grid, SE2.identity(), T_m0_v, cells=int(8.0 / cell_m), cell_m=cell_m)
    p_v = T_m0_v.inverse() @ grid.cell_centres(grid.occupied())
    col, row = np.floor(p_v.T / cell_m + window.cells.shape[1] / 2).astype(int)
    assert (window.cells[0, row, col] == OCCUPIED_CELL).all()


def test_pooling_keeps_walls_before_floor_before_the_unknown():
    cells = np.zeros((2, 4, 4), np.uint8)
    cells[0, 0, 1], cells[0, 1, 0], cells[0, 2, 3] = OCCUPIED_CELL, FREE_CELL, FREE_CELL
    pooled = MapWindow(cells=cells, cell_m=0.05).pooled(2)
    assert pooled.cell_m == approx(0.1)
    np.testing.assert_array_equal(pooled.cells[0], [[OCCUPIED_CELL, UNKNOWN_CELL], [UNKNOWN_CELL, FREE_CELL]])
    assert (pooled.cells[1] == UNKNOWN_CELL).all()


def test_undoing_the_perturbation_in_its_window_restores_the_aligned_map():
    grid_0, grid_1 = speckled(4), speckled(5)
    T_true, T_m0_r1, theta = SE2(0.5, -0.2, 0.6), SE2(0.3, 0.4, 0.0), SE2(0.6, -0.4, 0.5)
    T_estimated, T_m0_c = perturbed(T_true, T_m0_r1, theta)
    placed = map_window(grid_0, grid_1, T_estimated, T_m0_c @ theta, cells=80, cell_m=0.05)
    aligned = map_window(grid_0, grid_1, T_true, T_m0_c, cells=80, cell_m=0.05)
    # moved(θ u) = aligned(u): the placed map, seen from a window that moved along with it.
    np.testing.assert_array_equal(placed.cells[1], aligned.cells[1])
    assert (placed.cells[0] != aligned.cells[0]).mean() > 0.2


def test_search_covers_a_range_in_a_window_turned_by_any_angle():
    search = SearchRange.covering(xy_m=2.0, yaw_rad=0.5)
    for turn_rad in np.linspace(-math.pi, math.pi, 101):
        corner = SE2(0.0, 0.0, float(turn_rad)) @ np.array([2.0, -2.0])
        assert np.abs(corner).max() <= search.xy_m + 1e-12
    assert search.yaw_rad == 0.5
