"""Lines of sight in a map: no wall stands between two robots of which one sees the other.

Each map knows where its own robot stood at the sighting. In the right alignment both robots stand on free
floor, and neither map has a wall between them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from rendezvous.compiled import njit
from rendezvous.geometry.occupancy_grid import Cells, Mask

HIDDEN_CELL, OPEN_CELL, ROBOT_CELL = 0, 1, 2
"""Values of cells: behind a wall or out of range; in sight of the robot; under the robot."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RobotSight:
    """How far a robot sees, and how large it is; the defaults are those of the shipped weights' training."""

    range_m: float = 5.0
    radius_m: float = 0.1


def seen_from(occupied: Mask, robot_m: tuple[float, float], *, cell_m: float, robot: RobotSight) -> Cells:
    """(N, N) uint8: ROBOT_CELL under the robot, OPEN_CELL where it has a line of sight, known or not.

    Args:
        occupied: (N, N) the cells of a window that block sight.
        robot_m: x, y in the window frame [m]; outside the window nothing is marked.
        cell_m: side of a cell [m].
        robot: its range and radius.
    """
    out = np.zeros(occupied.shape, np.uint8)
    half = 0.5 * len(occupied)
    col, row = robot_m[0] / cell_m + half, robot_m[1] / cell_m + half
    _look_in_place(out, occupied, col, row, robot.range_m / cell_m, robot.radius_m / cell_m)
    return out


@njit
def _look_in_place(out: Cells, occupied: Mask, col: float, row: float, reach: float, radius: float) -> None:
    """Cast rays in all directions in steps of half a cell; their ends lie less than a cell apart."""
    size = out.shape[0]
    if not (0.0 <= col < size and 0.0 <= row < size):
        return
    rays = math.ceil(2.0 * math.pi * reach)
    for ray in range(rays):
        c, s = math.cos(2.0 * math.pi * ray / rays), math.sin(2.0 * math.pi * ray / rays)
        for step in range(math.floor(2.0 * reach) + 1):
            x, y = col + 0.5 * step * c, row + 0.5 * step * s
            if not (0.0 <= x < size and 0.0 <= y < size):
                break
            if 0.5 * step > radius and occupied[int(y), int(x)]:
                break
            out[int(y), int(x)] = OPEN_CELL
    for y in range(max(0, math.floor(row - radius)), min(size, math.ceil(row + radius))):
        for x in range(max(0, math.floor(col - radius)), min(size, math.ceil(col + radius))):
            if math.hypot(x + 0.5 - col, y + 0.5 - row) <= radius:
                out[y, x] = ROBOT_CELL
