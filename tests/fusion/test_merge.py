from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rendezvous.errors import ConfigError, MapError
from rendezvous.fusion.merge import CellEvidence, merged, on_common_grid, probabilistically_merged
from rendezvous.geometry.occupancy_grid import FREE, OCCUPIED, UNKNOWN, OccupancyGrid
from rendezvous.geometry.se2 import SE2
from tests.baselines.windows import REAL_T_M0_M1, real_maps
from tests.fusion.grids import constant_grid, drawn_grid, grids, poses, shown


def _algorithm_1(cells_0: np.ndarray, cells_1: np.ndarray) -> np.ndarray:
    """Algorithm 1 of the paper, letter by letter."""
    fused = np.empty_like(cells_0)
    for row in range(cells_0.shape[0]):
        for col in range(cells_0.shape[1]):
            if cells_0[row, col] == OCCUPIED or cells_1[row, col] == OCCUPIED:
                fused[row, col] = OCCUPIED
            elif cells_0[row, col] == UNKNOWN and cells_1[row, col] == UNKNOWN:
                fused[row, col] = UNKNOWN
            else:
                fused[row, col] = FREE
    return fused


@pytest.mark.parametrize("origin", [SE2(0.0, 0.0, 0.0), SE2(-3.25, 1.5, 0.0), SE2(0.1, -7.3, 0.0)])
def test_equal_grids_are_merged_as_algorithm_1_says(origin):
    grid_0, grid_1 = (drawn_grid(seed, T_m_g=origin) for seed in (0, 1))
    fused = merged(grid_0, grid_1, SE2.identity())
    assert np.array_equal(fused.cells, _algorithm_1(grid_0.cells, grid_1.cells))
    assert (fused.resolution_m, fused.T_m_g) == (grid_0.resolution_m, origin)


def test_algorithm_1_holds_on_the_common_grid_for_any_transform():
    pair = drawn_grid(0), drawn_grid(1, resolution_m=0.08)
    first, second = on_common_grid(*pair, SE2(0.4, -0.2, 1.0))
    fused = merged(*pair, SE2(0.4, -0.2, 1.0))
    assert np.array_equal(fused.cells, _algorithm_1(first.cells, second.cells))


@given(grids, grids, poses)
def test_the_fused_map_has_the_axes_of_map_0_and_the_finer_resolution(grid_0, grid_1, T_m0_m1):
    fused = merged(grid_0, grid_1, T_m0_m1)
    assert fused.resolution_m == min(grid_0.resolution_m, grid_1.resolution_m)
    assert fused.T_m_g.yaw_rad == 0.0
    corner = (fused.T_m_g.as_array() - grid_0.T_m_g.as_array())[:2] / fused.resolution_m
    assert corner == pytest.approx(np.round(corner), abs=1e-9)


@given(grids, grids, poses)
def test_every_occupied_cell_lies_in_an_occupied_cell(grid_0, grid_1, T_m0_m1):
    fused = merged(grid_0, grid_1, T_m0_m1)
    for grid, T_m0_m in ((grid_0, SE2.identity()), (grid_1, T_m0_m1)):
        walls_m0 = T_m0_m @ grid.cell_centres(grid.occupied())
        # A centre on the edge of two cells, within rounding, may be in either.
        near = [fused.sample(walls_m0 + np.array(d)) == OCCUPIED for d in _diagonals(1e-9)]
        assert np.any(near, axis=0).all()


def _diagonals(step_m: float) -> list[tuple[float, float]]:
    return [(x, y) for x in (-step_m, step_m) for y in (-step_m, step_m)]


@given(grids, grids, poses)
def test_the_fused_map_covers_both_maps_and_forgets_nothing(grid_0, grid_1, T_m0_m1):
    fused = merged(grid_0, grid_1, T_m0_m1)
    height_m, width_m = np.array(fused.cells.shape) * fused.resolution_m
    for grid, T_m0_m in ((grid_0, SE2.identity()), (grid_1, T_m0_m1)):
        height, width = grid.cells.shape
        corners = np.array([[0, 0], [width, 0], [width, height], [0, height]]) * grid.resolution_m
        p_g = fused.T_m_g.inverse() @ (T_m0_m @ (grid.T_m_g @ corners))
        assert (p_g >= -1e-6).all()
        assert (p_g <= np.array([width_m, height_m]) + 1e-6).all()
        centres_m0 = fused.cell_centres(np.ones_like(fused.occupied()))
        known = [
            grid.sample(T_m0_m.inverse() @ centres_m0 + np.array(d)) != UNKNOWN for d in _diagonals(1e-9)
        ]
        assert (fused.known().ravel() | ~np.all(known, axis=0)).all()


@given(grids, grids, poses)
def test_an_unknown_map_adds_nothing(grid_0, grid_1, T_m0_m1):
    nothing = constant_grid(UNKNOWN, like=grid_1)
    fused = merged(grid_0, nothing, T_m0_m1)
    alone, _ = on_common_grid(grid_0, nothing, T_m0_m1)
    assert np.array_equal(fused.cells, alone.cells)


def test_an_unknown_map_on_the_same_grid_returns_the_other_as_it_is():
    grid = drawn_grid(3)
    nothing = constant_grid(UNKNOWN, like=grid)
    for pair in ((grid, nothing), (nothing, grid)):
        assert np.array_equal(merged(*pair, SE2.identity()).cells, grid.cells)


@given(
    st.integers(0, 99),
    st.integers(-30, 30),
    st.integers(-30, 30),
    st.integers(0, 3),
)
def test_where_cells_fall_on_cells_either_map_may_be_the_first(seed, cols, rows, quarters):
    grid_0, grid_1 = drawn_grid(seed), drawn_grid(seed + 1, height=11)
    # Origins lie on the grid of cells, so quarter turns and whole cells keep all on one grid.
    T = SE2(0.05 * cols, 0.05 * rows, 0.5 * math.pi * quarters)
    fused_m0 = merged(grid_0, grid_1, T)
    fused_m1 = merged(grid_1, grid_0, T.inverse())
    p_m0 = fused_m0.cell_centres(np.ones_like(fused_m0.occupied()))
    assert np.array_equal(fused_m1.sample(T.inverse() @ p_m0), fused_m0.cells.ravel())
    assert fused_m0.known().sum() == fused_m1.known().sum()


def test_a_coarse_cell_becomes_the_fine_cells_that_it_covers():
    coarse = shown("#. ?#", resolution_m=2.0)
    fine = shown("?", resolution_m=1.0)
    for pair in ((coarse, fine), (fine, coarse)):
        fused = merged(*pair, SE2.identity())
        assert np.array_equal(fused.cells, np.kron(coarse.cells, np.ones((2, 2), np.uint8)))


def test_a_map_with_a_turned_origin_lies_where_its_origin_says():
    # Turned by a quarter about its own corner, the row of three becomes a column that leads up and left.
    turned = shown("#.?", T_m_g=SE2(1.0, 0.0, 0.5 * math.pi))
    upright = shown("? . #")
    for pair in ((turned, constant_grid(UNKNOWN, like=upright)), (upright, turned)):
        assert np.array_equal(merged(*pair, SE2.identity()).cells, upright.cells)


def test_a_thin_wall_that_is_turned_stays_closed():
    cells = np.full((60, 60), FREE, np.uint8)
    cells[30, 5:55] = OCCUPIED
    wall = OccupancyGrid(cells=cells, resolution_m=0.05, T_m_g=SE2(-1.5, -1.5, 0.0))
    fused = merged(constant_grid(UNKNOWN, like=wall), wall, SE2(0.013, 0.021, 0.6))
    along_m = np.linspace(-1.2, 1.2, 500)
    line_m0 = SE2(0.013, 0.021, 0.6) @ np.column_stack([along_m, np.full(500, 0.025)])
    near = [fused.sample(line_m0 + np.array(d)) == OCCUPIED for d in _diagonals(0.025)]
    assert np.any(near, axis=0).all()


def test_poses_that_put_the_maps_far_apart_are_refused():
    with pytest.raises(MapError, match=r"20000\d\d x \d+ cells of 0\.05 m; must be at most 100,000,000"):
        merged(drawn_grid(0), drawn_grid(1), SE2(1e5, 20.0, 0.0))


def test_evidence_of_two_maps_adds_up_in_log_odds():
    said_0, said_1 = shown("###...???"), shown("#.?#.?#.?")
    result = probabilistically_merged(said_0, said_1, SE2.identity())
    agree = 0.85**2 / (0.85**2 + 0.15**2)
    expected = [agree, 0.5, 0.85, 0.5, 1 - agree, 0.15, 0.85, 0.15, 0.5]
    assert result.occupied_probability[0] == pytest.approx(expected, abs=1e-6)
    assert np.array_equal(result.grid.cells, shown("#?#?..#.?").cells)


@pytest.mark.parametrize(
    ("evidence", "fused"),
    [
        (CellEvidence(), "?"),
        (CellEvidence(occupied_probability=0.95), "#"),
        (CellEvidence(free_probability=0.02), "."),
        (CellEvidence(trust_0=2.0), "#"),
        (CellEvidence(trust_1=2.0), "."),
        (CellEvidence(trust_0=0.0), "."),
    ],
)
def test_a_contradiction_is_settled_by_the_weights(evidence, fused):
    result = probabilistically_merged(shown("#"), shown("."), SE2.identity(), evidence)
    assert np.array_equal(result.grid.cells, shown(fused).cells)


@given(grids, grids, poses)
def test_where_maps_do_not_contradict_both_merges_are_the_same(grid_0, grid_1, T_m0_m1):
    first, second = on_common_grid(grid_0, grid_1, T_m0_m1)
    contradiction = (first.occupied() & second.free()) | (first.free() & second.occupied())
    weighed = probabilistically_merged(grid_0, grid_1, T_m0_m1).grid
    fused = merged(grid_0, grid_1, T_m0_m1)
    assert np.array_equal(weighed.cells[~contradiction], fused.cells[~contradiction])
    assert (weighed.cells[contradiction] == UNKNOWN).all()


def test_however_far_a_map_is_trusted_its_probabilities_stay_probabilities(recwarn):
    result = probabilistically_merged(shown("#.?"), shown(".#?"), SE2.identity(), CellEvidence(trust_0=100.0))
    assert result.occupied_probability[0] == pytest.approx([1.0, 0.0, 0.5])
    assert result.occupied_probability.dtype == np.float32
    assert np.array_equal(result.grid.cells, shown("#.?").cells)
    assert not recwarn.list


def test_evidence_that_is_none_is_refused():
    with pytest.raises(ConfigError, match=r"occupied_probability is 0\.3; must be from 0\.5 to 0\.999"):
        CellEvidence(occupied_probability=0.3)


def test_real_maps_are_merged_without_losing_a_wall(real_data):
    grid_0, grid_1, _ = real_maps(real_data)
    fused = merged(grid_0, grid_1, REAL_T_M0_M1)
    walls_m0 = REAL_T_M0_M1 @ grid_1.cell_centres(grid_1.occupied())
    assert (fused.sample(walls_m0) == OCCUPIED).all()
    assert (fused.sample(grid_0.cell_centres(grid_0.occupied())) == OCCUPIED).all()
