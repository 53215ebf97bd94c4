from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rendezvous.evaluation.metrics import distance_to_segments, ghost_cells, pose_error
from rendezvous.geometry.occupancy_grid import FREE, OCCUPIED, OccupancyGrid
from rendezvous.geometry.se2 import SE2

from tests.synthetic import RESOLUTION_M, building, synthetic_row

poses = st.builds(SE2, st.floats(-5, 5), st.floats(-5, 5), st.floats(-3.2, 3.2))


@cache
def _row(seed: int):
    return synthetic_row(np.random.default_rng(seed), plan=seed)


@pytest.fixture(scope="module", params=range(4))
def row(request):
    return _row(request.param)


def test_local_transform_is_the_chain_through_the_meeting(row):
    chain = row["T_m0_r0"] @ row["T_r0_r1_true"] @ row["T_m1_r1"].inverse()
    assert row["T_m0_m1_local"].as_array() == pytest.approx(chain.wrapped().as_array(), abs=1e-12)


def test_local_transform_is_the_start_transform_when_slam_is_right(row):
    chain = row["T_m0_r0_true"] @ row["T_r0_r1_true"] @ row["T_m1_r1_true"].inverse()
    assert chain.wrapped().as_array() == pytest.approx(row["T_m0_m1"].as_array(), abs=1e-12)


@given(poses)
def test_distance_to_a_segment_moves_with_it(T):
    points, segments = np.array([[0.5, 2.0], [-3.0, 4.0], [4.0, 0.0]]), np.array([[0.0, 0.0, 1.0, 0.0]])
    moved = np.hstack([T @ segments[:, :2], T @ segments[:, 2:]])
    assert distance_to_segments(T @ points, moved) == pytest.approx([2.0, 5.0, 3.0], abs=1e-9)


def test_nearest_of_several_segments_counts():
    segments = np.array([[0.0, 0.0, 1.0, 0.0], [0.0, 3.0, 1.0, 3.0]])
    assert distance_to_segments(np.array([[0.5, 2.0]]), segments) == pytest.approx([1.0])
    assert distance_to_segments(np.zeros((2, 2)), np.zeros((0, 4))) == pytest.approx([np.inf, np.inf])


def test_only_cells_on_the_other_robots_path_and_off_the_walls_are_ghosts():
    house = building(np.random.default_rng(0))
    T_w_m = SE2(1.0, 4.0, 0.2)
    cells = np.full((200, 300), FREE, np.uint8)
    grid = OccupancyGrid(cells=cells, resolution_m=RESOLUTION_M, T_m_g=SE2(-1.0, -4.0, 0.0))
    path_w_m = np.array([[6.0, 4.5], [7.0, 4.5]])
    marks_w_m = np.array([[6.1, 4.55], [9.0, 4.5], [0.1, 4.0]])
    for row, col in grid.cell_of(T_w_m.inverse() @ marks_w_m):
        grid.cells[row, col] = OCCUPIED
    ghosts = ghost_cells(grid, T_w_m, house.segments_m, path_w_m)
    assert ghosts.sum() == 1
    assert T_w_m @ grid.cell_centres(ghosts)[0] == pytest.approx(marks_w_m[0], abs=RESOLUTION_M)
    at_the_wall = ghost_cells(grid, T_w_m, house.segments_m, np.array([[0.2, 4.0]]))
    assert not at_the_wall.any()


@given(poses, poses)
def test_pose_error_is_the_length_and_turn_between_poses(T, D):
    error = pose_error(T @ D, T)
    assert error.position_m == pytest.approx(np.hypot(D.x_m, D.y_m), abs=1e-9)
    assert np.cos(error.heading_rad) == pytest.approx(np.cos(D.yaw_rad), abs=1e-9)
    assert 0.0 <= error.heading_rad <= np.pi
