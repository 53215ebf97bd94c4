"""Cheapest ways over a map of 140 x 140 planning cells: ours and scikit-image's, side by side."""

from __future__ import annotations

import argparse
import statistics
import time
from typing import Any

import numpy as np
from rendezvous.exploration.frontier import planning_map, reach
from rendezvous.geometry.occupancy_grid import FREE
from rendezvous.geometry.se2 import SE2
from skimage.graph import MCP_Geometric

REPEATS = 15


def measure(options: argparse.Namespace) -> dict[str, Any]:
    """Median milliseconds."""
    log_odds = np.full((280, 280), -2.0, np.float32)
    log_odds[[0, -1]] = log_odds[:, [0, -1]] = 2.0
    rng = np.random.default_rng(0)
    for row, col in rng.integers(10, 265, (60, 2)):
        log_odds[row : row + 6, col : col + 6] = 2.0
    plan = planning_map(log_odds, SE2.identity(), resolution_m=0.05, occupied=0.62, free=-0.62)
    start = tuple(int(v) for v in np.argwhere(plan.clearance_m > 0.4)[0])
    costs = np.where((plan.cells == FREE) & (plan.clearance_m >= 0.15), 1.0, -1.0)
    costs[plan.clearance_m < 0.30] *= 3.0
    ours, theirs = [], []
    for _ in range(REPEATS):
        started_s = time.perf_counter()
        reach(plan, (start[0], start[1]), hard_clearance_m=0.15, soft_clearance_m=0.30)
        ours.append(time.perf_counter() - started_s)
        started_s = time.perf_counter()
        MCP_Geometric(costs).find_costs([start])
        theirs.append(time.perf_counter() - started_s)
    ours_ms, theirs_ms = 1e3 * statistics.median(ours), 1e3 * statistics.median(theirs)
    return {
        "rendezvous_ms": round(ours_ms, 2),
        "skimage_mcp_ms": round(theirs_ms, 2),
        "times_faster": round(theirs_ms / ours_ms, 1),
    }
