"""Frontier exploration (Yamauchi, 1997) on the robot's own map, coarsened for planning."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from rendezvous.compiled import njit
from rendezvous.geometry.occupancy_grid import FREE, OCCUPIED, UNKNOWN, Cells
from rendezvous.geometry.se2 import SE2, Array

BLOCK = 2  # fine cells per side of a planning cell

# Lengths of a straight and a diagonal step in tenths of a cell, as the planner counts them.
_STRAIGHT, _DIAGONAL = 10, 14
_UNREACHED = np.iinfo(np.int32).max
_BUCKETS = 256


@dataclass(frozen=True, slots=True, kw_only=True)
class PlanningMap:
    """The map, coarsened for the planner."""

    cells: Cells  # (H, W) uint8 of UNKNOWN, FREE, OCCUPIED
    clearance_m: NDArray[np.float32]  # (H, W) float32 distance to the nearest occupied cell
    cell_m: float  # side of a cell
    T_m_g: SE2  # pose of the corner of cell (0, 0); no rotation

    def with_obstacles(self, points_m: Sequence[tuple[float, float]]) -> PlanningMap:
        """The same map with obstacles at these points of the map frame."""
        if not points_m:
            return self
        cells = self.cells.copy()
        for x_m, y_m in points_m:
            cells[self.cell_at(x_m, y_m)] = OCCUPIED
        return PlanningMap(
            cells=cells, clearance_m=_clearance(cells, self.cell_m), cell_m=self.cell_m, T_m_g=self.T_m_g
        )

    def centre_m(self, row: int, col: int) -> tuple[float, float]:
        """Centre of a cell in the map frame."""
        return self.T_m_g.x_m + (col + 0.5) * self.cell_m, self.T_m_g.y_m + (row + 0.5) * self.cell_m

    def cell_at(self, x_m: float, y_m: float) -> tuple[int, int]:
        """Row and col of a point, moved onto the grid."""
        height, width = self.cells.shape
        row = math.floor((y_m - self.T_m_g.y_m) / self.cell_m)
        col = math.floor((x_m - self.T_m_g.x_m) / self.cell_m)
        return min(max(row, 0), height - 1), min(max(col, 0), width - 1)


@njit
def _coarsen(log_odds: NDArray[np.float32], occupied: float, free: float) -> Cells:
    """Occupied if any fine cell is, free if half of them are; one unknown cell of margin all round."""
    height = (log_odds.shape[0] + BLOCK - 1) // BLOCK
    width = (log_odds.shape[1] + BLOCK - 1) // BLOCK
    cells = np.full((height + 2, width + 2), UNKNOWN, np.uint8)
    for row in range(height):
        for col in range(width):
            n_free = 0
            state = UNKNOWN
            for r in range(row * BLOCK, min(row * BLOCK + BLOCK, log_odds.shape[0])):
                for c in range(col * BLOCK, min(col * BLOCK + BLOCK, log_odds.shape[1])):
                    if log_odds[r, c] > occupied:
                        state = OCCUPIED
                    elif log_odds[r, c] < free:
                        n_free += 1
            if state != OCCUPIED and 2 * n_free >= BLOCK * BLOCK:
                state = FREE
            cells[row + 1, col + 1] = state
    return cells


def planning_map(
    log_odds: NDArray[np.float32], T_m_g: SE2, *, resolution_m: float, occupied: float, free: float
) -> PlanningMap:
    """Coarsen a log-odds grid (H, W); thresholds as for the occupancy grid."""
    cells = _coarsen(log_odds, occupied, free)
    cell_m = BLOCK * resolution_m
    return PlanningMap(
        cells=cells,
        clearance_m=_clearance(cells, cell_m),
        cell_m=cell_m,
        T_m_g=T_m_g @ SE2(-cell_m, -cell_m, 0.0),
    )


def _clearance(cells: Cells, cell_m: float) -> NDArray[np.float32]:
    cells_away = cv2.distanceTransform((cells != OCCUPIED).astype(np.uint8), cv2.DIST_L2, 5)
    return np.asarray(cells_away, np.float32) * np.float32(cell_m)


@njit
def _costs(
    cells: Cells, clearance_m: NDArray[np.float32], row0: int, col0: int, hard_m: float, soft_m: float
) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Dijkstra with a bucket queue (Dial, 1969): cost to and parent of every reachable cell.

    Close to the start, cells nearer to an obstacle than `hard_m` may be crossed, so that a robot that
    touches something can leave.
    """
    height, width = cells.shape
    cost = np.full(height * width, _UNREACHED, np.int32)
    parent = np.full(height * width, -1, np.int32)
    heads = np.full(_BUCKETS, -1, np.int32)
    nodes = np.empty((8 * height * width + 1, 2), np.int32)
    n_nodes = 1
    start = row0 * width + col0
    cost[start] = 0
    nodes[0, 0], nodes[0, 1] = start, -1
    heads[0] = 0
    current, idle = 0, 0
    while idle < _BUCKETS:
        node = heads[current % _BUCKETS]
        if node < 0:
            current += 1
            idle += 1
            continue
        idle = 0
        heads[current % _BUCKETS] = nodes[node, 1]
        cell = nodes[node, 0]
        if cost[cell] != current:
            continue
        row, col = cell // width, cell % width
        for r in range(max(row - 1, 0), min(row + 2, height)):
            for c in range(max(col - 1, 0), min(col + 2, width)):
                near = clearance_m[r, c]
                if cells[r, c] != FREE or (near < hard_m and (abs(r - row0) > 2 or abs(c - col0) > 2)):
                    continue
                total = current + _step_cost(r != row and c != col, near, hard_m, soft_m)
                neighbour = r * width + c
                if total < cost[neighbour]:
                    cost[neighbour] = total
                    parent[neighbour] = cell
                    nodes[n_nodes, 0], nodes[n_nodes, 1] = neighbour, heads[total % _BUCKETS]
                    heads[total % _BUCKETS] = n_nodes
                    n_nodes += 1
    return cost.reshape(height, width), parent


@njit(inline="always")
def _step_cost(is_diagonal: bool, clearance_m: float, hard_m: float, soft_m: float) -> int:
    """Tenths of a cell; near obstacles up to five times as much."""
    step = _DIAGONAL if is_diagonal else _STRAIGHT
    if clearance_m < soft_m:
        step = int(step * (1.0 + 4.0 * (soft_m - clearance_m) / (soft_m - hard_m * 0.5)))
    return min(step, _BUCKETS - 1)


@njit
def _frontiers(
    cells: Cells, cost: NDArray[np.int32], least: int
) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Clusters of reachable cells beside unknown ones: (F, 2) cell nearest each centre, and (F,) sizes."""
    height, width = cells.shape
    seen = np.zeros((height, width), np.bool_)
    queue = np.empty(height * width, np.int32)
    found = np.empty((height * width // least + 1, 2), np.int32)
    sizes = np.empty(height * width // least + 1, np.int32)
    count = 0
    for row in range(1, height - 1):
        for col in range(1, width - 1):
            if seen[row, col] or not _is_frontier(cells, cost, row, col):
                continue
            seen[row, col] = True
            queue[0] = row * width + col
            begin, end = 0, 1
            sum_r, sum_c = 0, 0
            while begin < end:
                r, c = queue[begin] // width, queue[begin] % width
                begin += 1
                sum_r += r
                sum_c += c
                for rr in range(r - 1, r + 2):
                    for cc in range(c - 1, c + 2):
                        if not seen[rr, cc] and _is_frontier(cells, cost, rr, cc):
                            seen[rr, cc] = True
                            queue[end] = rr * width + cc
                            end += 1
            if end < least:
                continue
            best, best_d2 = 0, np.inf
            for k in range(end):
                d2 = (queue[k] // width - sum_r / end) ** 2 + (queue[k] % width - sum_c / end) ** 2
                if d2 < best_d2:
                    best, best_d2 = k, d2
            found[count, 0], found[count, 1] = queue[best] // width, queue[best] % width
            sizes[count] = end
            count += 1
    return found[:count], sizes[:count]


@njit(inline="always")
def _is_frontier(cells: Cells, cost: NDArray[np.int32], row: int, col: int) -> bool:
    if not (0 < row < cells.shape[0] - 1 and 0 < col < cells.shape[1] - 1):
        return False
    if cells[row, col] != FREE or cost[row, col] == _UNREACHED:
        return False
    return (
        cells[row - 1, col] == UNKNOWN
        or cells[row + 1, col] == UNKNOWN
        or cells[row, col - 1] == UNKNOWN
        or cells[row, col + 1] == UNKNOWN
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class Reach:
    """The cheapest ways from one cell to all that can be reached from it."""

    cost: NDArray[np.int32]  # (H, W) int32 in tenths of a cell, the largest int32 where there is no way
    parent: NDArray[np.int32]  # (H * W,) int32 previous cell on the way, -1 at the start

    def reachable(self) -> NDArray[np.bool_]:
        """(H, W) bool."""
        return self.cost != _UNREACHED


def reach(
    plan: PlanningMap, row_col: tuple[int, int], *, hard_clearance_m: float, soft_clearance_m: float
) -> Reach:
    """Cheapest ways from a cell to everywhere.

    The robot's centre never comes closer to an obstacle than the hard clearance, and closer than the soft one
    only if the way round is much longer.
    """
    cost, parent = _costs(plan.cells, plan.clearance_m, *row_col, hard_clearance_m, soft_clearance_m)
    return Reach(cost=cost, parent=parent)


def frontiers(plan: PlanningMap, ways: Reach, *, least_m: float) -> tuple[NDArray[np.int32], Array, Array]:
    """Reachable frontiers at least `least_m` long.

    Returns:
        (F, 2) int32 row, col of the frontier cell nearest each one's centre; (F,) travel cost [m];
        (F,) length [m].
    """
    found, sizes = _frontiers(plan.cells, ways.cost, max(1, math.ceil(least_m / plan.cell_m)))
    cost_m = ways.cost[found[:, 0], found[:, 1]] * (plan.cell_m / _STRAIGHT)
    return found, cost_m, sizes * plan.cell_m


def path_m(plan: PlanningMap, ways: Reach, row_col: tuple[int, int]) -> Array:
    """(N, 2) [m] cell centres from the start (left out) to a reachable cell."""
    width = plan.cells.shape[1]
    cell = row_col[0] * width + row_col[1]
    cells = []
    while ways.parent[cell] >= 0:
        cells.append(cell)
        cell = int(ways.parent[cell])
    row, col = np.divmod(np.array(cells[::-1] or [cell], np.int64), width)
    cells_m = plan.cell_m * (np.stack([col, row], axis=1) + 0.5)
    return cells_m + np.array([plan.T_m_g.x_m, plan.T_m_g.y_m])
