"""Cheapest paths over a map of 140 x 140 planning cells: ours and scikit-image's, side by side."""

from __future__ import annotations

import argparse
from typing import Any

import numpy as np
from skimage.graph import MCP_Geometric

from benchmarks.clocks import side_by_side_s
from rendezvous.exploration.frontier import planning_map, reach
from rendezvous.geometry.occupancy_grid import FREE
from rendezvous.geometry.se2 import SE2

REPEATS = 15


def measure(options: argparse.Namespace) -> dict[str, Any]:
    """Median milliseconds."""
    log_odds = np.full((280, 280), -2.0, np.float32)
    log_odds[[0, -1]] = log_odds[:, [0, -1]] = 2.0
    rng = np.random.default_rng(0)
    for row, col in rng.integers(10, 265, (60, 2)):
        log_odds[row : row + 6, col : col + 6] = 2.0
    plan = planning_map(log_odds, SE2.identity(), resolution_m=0.05, occupied=0.62, free=-0.62)
    row, col = np.argwhere(plan.clearance_m > 0.4)[0]
    start = int(row), int(col)
    costs = np.where((plan.cells == FREE) & (plan.clearance_m >= 0.15), 1.0, -1.0)
    costs[plan.clearance_m < 0.30] *= 3.0
    ways = {
        "rendezvous": lambda: reach(plan, start, hard_clearance_m=0.15, soft_clearance_m=0.30),
        "skimage_mcp": lambda: MCP_Geometric(costs).find_costs([start]),
    }
    times_s = side_by_side_s(ways, repeats=REPEATS)
    return {
        **{f"{name}_ms": round(1e3 * value_s, 2) for name, value_s in times_s.items()},
        "times_faster": round(times_s["skimage_mcp"] / times_s["rendezvous"], 1),
    }
