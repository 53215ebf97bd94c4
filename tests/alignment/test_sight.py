"""Lines of sight from a robot."""

from __future__ import annotations

import numpy as np
import pytest
from rendezvous.alignment.sight import HIDDEN_CELL, OPEN_CELL, ROBOT_CELL, RobotSight, seen_from
from rendezvous.alignment.window import map_window
from rendezvous.geometry.occupancy_grid import FREE, OCCUPIED, OccupancyGrid
from rendezvous.geometry.se2 import SE2
from scipy.ndimage import maximum_filter, minimum_filter


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
