"""Where an exploring robot goes next."""

from __future__ import annotations

import math

import numpy as np

from rendezvous.exploration.frontier import PlanningMap, Reach, frontiers, path_m, planning_map, reach
from rendezvous.exploration.records import ExplorerParameters
from rendezvous.geometry.se2 import Array
from rendezvous.slam.mapping import OccupancyMapper

_SHUN_S = 30.0
_SHUN_MARGIN_M = 0.395
"""A goal within the robot's radius and this of one that was given up is avoided as well."""


class Goals:
    """Chooses goals on the robot's own map, and remembers those to avoid for a while.

    Every margin of the parameters is added to the robot's radius.
    """

    def __init__(
        self, parameters: ExplorerParameters, *, robot_radius_m: float, rng: np.random.Generator
    ) -> None:
        self._p = parameters
        self._radius_m = robot_radius_m
        self._rng = rng
        # x, y [m], and the time [s] until which it counts.
        self._shunned: list[tuple[float, float, float]] = []
        self._bumps: list[tuple[float, float, float]] = []

    def shun(self, goal_m: Array, *, time_s: float) -> None:
        """Avoid goals near this one (x, y in the map) for a while."""
        self._shunned.append((float(goal_m[0]), float(goal_m[1]), time_s + _SHUN_S))

    def bump(self, place_m: Array, *, time_s: float) -> None:
        """Treat this place (x, y, ... in the map), where the robot met something unseen, as an obstacle."""
        self._bumps.append((float(place_m[0]), float(place_m[1]), time_s + _SHUN_S))

    def path_m(
        self, mapper: OccupancyMapper, pose: Array, last_m: Array, *, time_s: float, keep_patrol: bool
    ) -> Array:
        """(N, 2) [m] path to the frontier that costs least for its length; without frontiers, to anywhere.

        Empty if nothing can be reached. Without frontiers, `keep_patrol` goes on to where the last path
        leads.
        """
        self._shunned = [place for place in self._shunned if place[2] > time_s]
        self._bumps = [place for place in self._bumps if place[2] > time_s]
        p, mapping = self._p, mapper.parameters
        log_odds, T_m_g = mapper.window()
        plan = planning_map(
            log_odds, T_m_g, resolution_m=mapping.resolution_m, occupied=mapping.occupied, free=mapping.free
        ).with_obstacles([(x_m, y_m) for x_m, y_m, _ in self._bumps])
        ways = reach(
            plan,
            plan.cell_at(pose[0], pose[1]),
            hard_clearance_m=self._radius_m + p.hard_margin_m,
            soft_clearance_m=self._radius_m + p.soft_margin_m,
        )
        kept_m = last_m[-1] if keep_patrol and len(last_m) > 1 else None
        goal = self._frontier(plan, ways) or self._patrol(plan, ways, kept_m)
        return path_m(plan, ways, goal) if goal is not None else np.zeros((0, 2))

    def _frontier(self, plan: PlanningMap, ways: Reach) -> tuple[int, int] | None:
        cells, cost_m, length_m = frontiers(plan, ways, least_m=self._p.least_frontier_m)
        shun_m = self._radius_m + _SHUN_MARGIN_M
        best, best_score = None, math.inf
        for (row, col), cost, length in zip(cells.tolist(), cost_m, length_m, strict=True):
            x_m, y_m = plan.centre_m(row, col)
            if any(math.hypot(x_m - sx, y_m - sy) < shun_m for sx, sy, _ in self._shunned):
                continue
            score = cost - self._p.gain * length
            if cost >= self._p.lookahead_m and score < best_score:
                best, best_score = (row, col), score
        return best

    def _patrol(self, plan: PlanningMap, ways: Reach, kept_m: Array | None) -> tuple[int, int] | None:
        """The goal to keep if it can be reached, else uniform over the reachable cells with room to turn."""
        reachable = ways.reachable()
        if kept_m is not None and reachable[kept := plan.cell_at(*kept_m)]:
            return kept
        room_m = self._radius_m + self._p.soft_margin_m
        cells = np.argwhere(reachable & (plan.clearance_m > room_m))
        if len(cells) == 0:
            return None
        row, col = cells[self._rng.integers(len(cells))]
        return int(row), int(col)
