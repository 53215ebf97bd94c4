from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rendezvous.evaluation.metrics import distance_to_segments, ghost_cells, pose_error
from rendezvous.geometry.occupancy_grid import FREE, OCCUPIED, OccupancyGrid
from rendezvous.geometry.se2 import SE2

poses = st.builds(SE2, st.floats(-5, 5), st.floats(-5, 5), st.floats(-3.2, 3.2))


@given(poses)
def test_the_nearest_segment_counts_and_distances_move_with_it(T):
    points = np.array([[0.5, 2.0], [-3.0, 4.0], [4.0, 0.0]])
    segments = np.array([[0.0, 0.0, 1.0, 0.0], [0.0, 3.0, 1.0, 3.0]])
    for counted, wanted in ((segments[:1], [2.0, 5.0, 3.0]), (segments, [1.0, np.sqrt(10.0), 3.0])):
        moved = np.hstack([T @ counted[:, :2], T @ counted[:, 2:]])
        assert distance_to_segments(T @ points, moved) == pytest.approx(wanted, abs=1e-9)
    assert distance_to_segments(points, np.zeros((0, 4))) == pytest.approx([np.inf] * 3)


def test_only_cells_on_the_other_robots_path_and_off_the_walls_are_ghosts():
    wall_m = np.array([[0.0, 0.0, 0.0, 9.0]])
    T_w_m = SE2(1.0, 4.0, 0.2)
    cells = np.full((200, 300), FREE, np.uint8)
    grid = OccupancyGrid(cells=cells, resolution_m=0.05, T_m_g=SE2(-1.0, -4.0, 0.0))
    marks_w_m = np.array([[6.1, 4.55], [9.0, 4.5], [0.1, 4.0]])
    rows, cols = grid.cell_of(T_w_m.inverse() @ marks_w_m).T
    cells[rows, cols] = OCCUPIED
    ghosts = ghost_cells(grid, T_w_m, wall_m, np.array([[6.0, 4.5], [7.0, 4.5]]))
    assert ghosts.sum() == 1
    assert T_w_m @ grid.cell_centres(ghosts)[0] == pytest.approx(marks_w_m[0], abs=0.05)
    assert not ghost_cells(grid, T_w_m, wall_m, np.array([[0.2, 4.0]])).any()


@given(poses, poses)
def test_pose_error_is_the_length_and_turn_between_poses(T, D):
    error = pose_error(T @ D, T)
    assert error.position_m == pytest.approx(np.hypot(D.x_m, D.y_m), abs=1e-9)
    assert np.cos(error.heading_rad) == pytest.approx(np.cos(D.yaw_rad), abs=1e-9)
    assert 0.0 <= error.heading_rad <= np.pi
