from __future__ import annotations

import math

import numpy as np
import pytest
from pytest import approx
from scipy.ndimage import maximum_filter, minimum_filter

from rendezvous.alignment.estimate import WRONG_M, WRONG_RAD
from rendezvous.alignment.frame_error import perturbed
from rendezvous.alignment.window import (
    DEFAULT_SEARCH,
    FREE_CELL,
    HIDDEN_CELL,
    OCCUPIED_CELL,
    OPEN_CELL,
    ROBOT_CELL,
    UNKNOWN_CELL,
    MapWindow,
    RobotSight,
    SearchRange,
    map_window,
    seen_from,
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


def _cell(x_m: float, y_m: float, *, cells: int, cell_m: float) -> tuple[int, int]:
    return int(y_m / cell_m + cells / 2), int(x_m / cell_m + cells / 2)


def test_a_wall_hides_what_is_behind_it_and_a_gap_lets_it_be_seen() -> None:
    cells, cell_m = 160, 0.05
    occupied = np.zeros((cells, cells), bool)
    occupied[:, 100] = True  # a wall at x = 1 m ...
    occupied[76:84, 100] = False  # ... open for |y| < 0.2 m
    seen = seen_from(occupied, (0.0, 0.0), cell_m=cell_m, robot=RobotSight())
    assert seen[_cell(3.0, 0.0, cells=cells, cell_m=cell_m)] == OPEN_CELL  # through the gap
    assert seen[_cell(3.0, 1.2, cells=cells, cell_m=cell_m)] == HIDDEN_CELL  # beside its cone
    assert seen[_cell(0.8, 2.0, cells=cells, cell_m=cell_m)] == OPEN_CELL  # on this side
    assert seen[_cell(0.0, 0.0, cells=cells, cell_m=cell_m)] == ROBOT_CELL
    assert (seen[:, 101:][occupied[:, 101:]] == HIDDEN_CELL).all()


def test_what_is_seen_agrees_with_a_segment_to_every_cell() -> None:
    rng = np.random.default_rng(0)
    occupied = maximum_filter(rng.random((80, 80)) < 0.004, 3)
    robot_m, cell_m = (0.42, -0.61), 0.05
    seen = seen_from(occupied, robot_m, cell_m=cell_m, robot=RobotSight(range_m=1.5))
    row, col = np.indices(occupied.shape)
    x_m, y_m = ((col + 0.5 - 40) * cell_m, (row + 0.5 - 40) * cell_m)
    steps = np.linspace(0.0, 1.0, 400)[:, None, None]
    near = steps * np.hypot(x_m - robot_m[0], y_m - robot_m[1]) > 0.1
    hit = np.zeros(occupied.shape, bool)
    for share, beyond in zip(steps, near, strict=True):
        at_x, at_y = robot_m[0] + share * (x_m - robot_m[0]), robot_m[1] + share * (y_m - robot_m[1])
        hit |= beyond & occupied[(at_y / cell_m + 40).astype(int), (at_x / cell_m + 40).astype(int)]
    distance_m = np.hypot(x_m - robot_m[0], y_m - robot_m[1])
    edges = maximum_filter(hit, 3) != minimum_filter(hit, 3)  # of shadows
    inside = (distance_m > 0.15) & (distance_m < 1.4) & ~edges
    assert hit[inside].sum() > 100
    agree = ((seen > HIDDEN_CELL) == ~hit)[inside]
    assert agree.mean() > 0.995
    assert (seen[distance_m > 1.6] == HIDDEN_CELL).all()


@pytest.mark.parametrize("radius_m", [0.1, 0.3])
def test_a_robot_covers_a_disc_of_its_radius_even_within_walls(radius_m: float) -> None:
    robot = RobotSight(range_m=1.0, radius_m=radius_m)
    seen = seen_from(np.ones((80, 80), bool), (0.31, -0.42), cell_m=0.05, robot=robot)
    row, col = (np.indices(seen.shape) + 0.5 - 40) * 0.05
    under = np.hypot(col - 0.31, row + 0.42) <= radius_m
    np.testing.assert_array_equal(seen == ROBOT_CELL, under)


@pytest.mark.parametrize("robot_m", [(5.0, 0.0), (0.0, -2.1), (-40.0, 40.0)])
def test_a_robot_outside_the_window_marks_nothing(robot_m: tuple[float, float]) -> None:
    assert not seen_from(np.zeros((80, 80), bool), robot_m, cell_m=0.05, robot=RobotSight()).any()


def test_a_window_shows_each_robot_in_its_own_map() -> None:
    values = np.full((200, 200), FREE, np.uint8)
    values[:, 150] = OCCUPIED  # at x = 2.5 m in m0
    grid = OccupancyGrid(cells=values, resolution_m=0.05, T_m_g=SE2(-5.0, -5.0, 0.0))
    T_m0_v = SE2(1.0, 0.5, 0.7)
    T_m0_r0 = SE2(-0.4, 0.9, 2.0)
    maps = map_window(grid, grid, SE2.identity(), T_m0_v, cells=128)
    window = map_window(grid, grid, SE2.identity(), T_m0_v, T_m0_r0=T_m0_r0, cells=128)
    assert maps.sight is None
    assert window.sight is not None
    np.testing.assert_array_equal(window.cells, maps.cells)
    T_v_r0 = T_m0_v.inverse() @ T_m0_r0
    for sight, (x_m, y_m) in zip(window.sight, ((T_v_r0.x_m, T_v_r0.y_m), (0.0, 0.0)), strict=True):
        row, col = (np.argwhere(sight == ROBOT_CELL) + 0.5).mean(axis=0)
        assert np.hypot((col - 64) * 0.05 - x_m, (row - 64) * 0.05 - y_m) < 0.05
    assert window.without_sight().sight is None
    pooled = window.pooled(2)
    assert pooled.sight is not None
    assert pooled.sight.shape == (2, 64, 64)
    assert (pooled.sight == ROBOT_CELL).any(axis=(1, 2)).all()


def test_without_other_wishes_the_window_and_its_search_are_the_papers() -> None:
    grid = speckled(0)
    window = map_window(grid, grid, SE2.identity(), SE2.identity(), T_m0_r0=SE2(0.5, 0.0, 0.0))
    assert window.cells.shape == (2, 384, 384)
    assert window.cell_m == 0.05
    assert SearchRange.covering(xy_m=2.0, yaw_rad=math.pi / 4) == DEFAULT_SEARCH
    # Robots of 0.1 m, which cover 12 cells at 0.05 m.
    assert (window.sight == ROBOT_CELL).sum(axis=(1, 2)).tolist() == [12, 12]


def test_a_robot_that_sees_less_far_and_is_larger_is_drawn_so() -> None:
    grid = OccupancyGrid(
        cells=np.full((200, 200), FREE, np.uint8), resolution_m=0.05, T_m_g=SE2(-5.0, -5.0, 0.0)
    )
    for robot in (None, RobotSight(range_m=1.5, radius_m=0.3)):
        window = map_window(
            grid, grid, SE2.identity(), SE2.identity(), T_m0_r0=SE2.identity(), cells=256, robot=robot
        )
        assert window.sight is not None
        at_m = np.hypot(*((np.indices((256, 256)) + 0.5 - 128) * 0.05))
        for sight in window.sight:
            assert at_m[sight > HIDDEN_CELL].max() == approx(5.0 if robot is None else 1.5, abs=0.05)
            assert at_m[sight == ROBOT_CELL].max() == approx(0.1 if robot is None else 0.3, abs=0.03)
        reached = window.sight[0] > HIDDEN_CELL
        assert reached[at_m < (4.9 if robot is None else 1.4)].all()


def test_what_makes_an_alignment_wrong_is_half_a_metre_or_five_degrees() -> None:
    assert WRONG_M == 0.5
    assert math.degrees(WRONG_RAD) == approx(5.0)


def test_what_lies_under_the_robot_does_not_hide_the_rest() -> None:
    """Its own map may take the robot's place for occupied: what another robot saw there was the robot."""
    occupied = np.zeros((80, 80), bool)
    occupied[39:41, 39:41] = True
    robot = RobotSight(range_m=1.5)
    freely = seen_from(np.zeros((80, 80), bool), (0.0, 0.0), cell_m=0.05, robot=robot)
    np.testing.assert_array_equal(seen_from(occupied, (0.0, 0.0), cell_m=0.05, robot=robot), freely)
    occupied[:, 43] = True  # 0.15 m away: outside of its radius
    hidden = seen_from(occupied, (0.0, 0.0), cell_m=0.05, robot=robot)
    assert not hidden[:, 44:].any()
