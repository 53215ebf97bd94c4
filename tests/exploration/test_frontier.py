import math

import networkx as nx
import numpy as np
from numpy.typing import NDArray
from pytest import approx

from rendezvous.exploration.frontier import PlanningMap, frontiers, path_m, planning_map, reach
from rendezvous.geometry import occupancy_grid as grid_values
from rendezvous.geometry.se2 import SE2

FREE, WALL, DARK = -2.0, 2.0, 0.0


def plan_of(log_odds: NDArray[np.float32], T_m_g: SE2 | None = None) -> PlanningMap:
    return planning_map(
        log_odds.astype(np.float32),
        T_m_g or SE2.identity(),
        resolution_m=0.05,
        occupied=0.62,
        free=-0.62,
    )


def room(height: int = 80, width: int = 120) -> NDArray[np.float32]:
    """(H, W) log-odds of an empty walled room of 0.05 m cells."""
    cells = np.full((height, width), FREE, np.float32)
    cells[[0, 1, -2, -1]] = WALL
    cells[:, [0, 1, -2, -1]] = WALL
    return cells


def test_coarse_cells_keep_every_wall_and_lie_where_the_fine_ones_did() -> None:
    fine = np.full((40, 40), FREE, np.float32)
    fine[20, 7] = WALL
    plan = plan_of(fine, SE2(1.0, 2.0, 0.0))
    rows, cols = np.nonzero(plan.cells == grid_values.OCCUPIED)
    assert len(rows) == 1
    x_m, y_m = plan.centre_m(rows[0], cols[0])
    assert (x_m, y_m) == (approx(1.0 + 7.5 * 0.05, abs=0.05), approx(2.0 + 20.5 * 0.05, abs=0.05))
    assert plan.cell_at(x_m, y_m) == (rows[0], cols[0])


def test_costs_are_those_of_dijkstra() -> None:
    rng = np.random.default_rng(2)
    fine = room()
    for _ in range(25):
        r, c = rng.integers(4, 70), rng.integers(4, 110)
        fine[r : r + rng.integers(1, 8), c : c + rng.integers(1, 8)] = WALL
    plan = plan_of(fine)
    hard_m, soft_m = 0.12, 0.30
    start = tuple(np.argwhere((plan.cells == grid_values.FREE) & (plan.clearance_m > 0.4))[0])
    ways = reach(plan, (int(start[0]), int(start[1])), hard_clearance_m=hard_m, soft_clearance_m=soft_m)
    graph = nx.DiGraph()
    for r, c in np.argwhere(plan.cells == grid_values.FREE):
        for dr in (-1, 0, 1):
            for dc in (-1, 0, 1):
                rr, cc = r + dr, c + dc
                near = plan.clearance_m[rr, cc]
                close = max(abs(rr - start[0]), abs(cc - start[1])) <= 2
                if (
                    (dr, dc) == (0, 0)
                    or plan.cells[rr, cc] != grid_values.FREE
                    or (near < hard_m and not close)
                ):
                    continue
                step = 14 if dr and dc else 10
                if near < soft_m:
                    step = int(step * (1.0 + 4.0 * (soft_m - near) / (soft_m - 0.5 * hard_m)))
                graph.add_edge((r, c), (rr, cc), weight=step)
    expected = nx.single_source_dijkstra_path_length(graph, start)
    reached = {tuple(cell) for cell in np.argwhere(ways.reachable())}
    assert reached == set(expected)
    assert all(ways.cost[cell] == cost for cell, cost in expected.items())


def test_a_path_goes_through_the_door_and_keeps_off_the_walls() -> None:
    fine = room()
    fine[:, 60:62] = WALL
    fine[30:46, 60:62] = FREE  # a door of 0.8 m
    plan = plan_of(fine)
    ways = reach(plan, plan.cell_at(1.0, 1.0), hard_clearance_m=0.15, soft_clearance_m=0.3)
    goal = plan.cell_at(5.0, 3.0)
    path = path_m(plan, ways, goal)
    assert np.abs(np.diff(path, axis=0)).max() <= 0.1 + 1e-9
    assert path[-1] == approx(plan.centre_m(*goal))
    crossing = path[np.abs(path[:, 0] - 3.05) < 0.06]
    assert len(crossing)
    assert ((crossing[:, 1] > 1.65) & (crossing[:, 1] < 2.15)).all()


def test_beyond_a_gap_too_narrow_for_the_robot_nothing_is_reachable() -> None:
    fine = room()
    fine[:, 60:62] = WALL
    fine[30:34, 60:62] = FREE  # 0.2 m
    plan = plan_of(fine)
    ways = reach(plan, plan.cell_at(1.0, 1.0), hard_clearance_m=0.15, soft_clearance_m=0.3)
    assert not ways.reachable()[plan.cell_at(5.0, 3.0)]


def test_the_edge_of_the_dark_is_one_frontier_as_long_as_it_is() -> None:
    fine = room()
    fine[2:-2, 80:-2] = DARK
    plan = plan_of(fine)
    ways = reach(plan, plan.cell_at(1.0, 1.0), hard_clearance_m=0.15, soft_clearance_m=0.3)
    cells, cost_m, length_m = frontiers(plan, ways, least_m=0.4)
    assert len(cells) == 1
    x_m, y_m = plan.centre_m(*cells[0])
    assert (x_m, y_m) == (approx(4.0, abs=0.1), approx(2.0, abs=0.15))
    assert length_m[0] == approx(4.0 - 2 * 0.1 - 2 * 0.15, abs=0.15)
    assert cost_m[0] == approx(math.dist((1.0, 1.0), (4.0, 2.0)), rel=0.15)


def test_a_short_frontier_is_not_worth_a_visit() -> None:
    fine = room()
    fine[20:24, 40:44] = DARK
    plan = plan_of(fine)
    ways = reach(plan, plan.cell_at(1.0, 1.0), hard_clearance_m=0.15, soft_clearance_m=0.3)
    assert len(frontiers(plan, ways, least_m=1.2)[0]) == 0
    assert len(frontiers(plan, ways, least_m=0.1)[0]) == 1


def test_something_that_was_felt_is_planned_around() -> None:
    plan = plan_of(room())
    felt = plan.with_obstacles([(2.0, 2.0)])
    row, col = plan.cell_at(2.0, 2.0)
    assert plan.clearance_m[row, col] > 1.0
    assert felt.clearance_m[row, col] == 0.0
    ways = reach(felt, felt.cell_at(1.0, 2.0), hard_clearance_m=0.15, soft_clearance_m=0.3)
    path = path_m(felt, ways, felt.cell_at(3.0, 2.0))
    assert np.hypot(path[:, 0] - 2.0, path[:, 1] - 2.0).min() > 0.15


def test_a_cell_free_by_half_is_free_and_by_a_quarter_unknown() -> None:
    fine = np.full((4, 4), DARK, np.float32)
    fine[0, :2] = FREE  # half of the first coarse cell
    fine[0, 2] = FREE  # a quarter of the second
    fine[2, :2], fine[3, :2] = FREE, WALL  # free and occupied
    free, unknown, occupied = grid_values.FREE, grid_values.UNKNOWN, grid_values.OCCUPIED
    assert plan_of(fine).cells[1:3, 1:3].tolist() == [[free, unknown], [occupied, unknown]]
    # An odd last row and column count as far as they go.
    assert plan_of(np.full((3, 3), FREE, np.float32)).cells[1:3, 1:3].tolist() == [
        [free, free],
        [free, unknown],
    ]


def test_the_dark_is_a_frontier_on_whichever_side_it_lies() -> None:
    for dark in (np.s_[2:20, 2:-2], np.s_[-20:-2, 2:-2], np.s_[2:-2, 2:20], np.s_[2:-2, -20:-2]):
        fine = room()
        fine[dark] = DARK
        plan = plan_of(fine)
        ways = reach(plan, plan.cell_at(3.0, 2.0), hard_clearance_m=0.15, soft_clearance_m=0.3)
        assert len(frontiers(plan, ways, least_m=0.4)[0]) == 1


def test_a_frontier_just_as_long_as_the_least_counts() -> None:
    fine = room()
    fine[2:-2, 80:-2] = WALL
    fine[30:46, 80:-2] = DARK  # 8 coarse cells of it can be seen
    plan = plan_of(fine)
    ways = reach(plan, plan.cell_at(1.0, 1.0), hard_clearance_m=0.0, soft_clearance_m=0.1)
    (length_m,) = frontiers(plan, ways, least_m=0.1)[2]
    assert length_m == approx(0.8)
    assert len(frontiers(plan, ways, least_m=length_m)[0]) == 1
    assert len(frontiers(plan, ways, least_m=length_m + 0.01)[0]) == 0
