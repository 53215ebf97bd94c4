"""The `explore` stage with one worker and with two, taking turns."""

from __future__ import annotations

import argparse
import shutil
import statistics
import tempfile
import time
from pathlib import Path
from typing import Any

from benchmarks.scene import run_stage

REPEATS = 2
_SETTINGS = ["--set", "floorplans.generate.count=0", "--set", "explore.episodes_per_plan=4"]


def measure(options: argparse.Namespace) -> dict[str, Any]:
    """Median seconds with one worker and with two, and their ratio."""
    with tempfile.TemporaryDirectory() as data:
        for stage in ("floorplans", "meshes"):
            run_stage(stage, "--data", data, *_SETTINGS)
        times_s: dict[int, list[float]] = {1: [], 2: []}
        for _ in range(REPEATS):
            for workers in (1, 2):
                shutil.rmtree(Path(data, "explore"), ignore_errors=True)
                started_s = time.perf_counter()
                run_stage("explore", "--data", data, "--workers", str(workers), *_SETTINGS)
                times_s[workers].append(time.perf_counter() - started_s)
    ratios = [one / two for one, two in zip(times_s[1], times_s[2], strict=True)]
    return {
        "one_worker_s": round(statistics.median(times_s[1]), 1),
        "two_workers_s": round(statistics.median(times_s[2]), 1),
        "times_faster": round(statistics.median(ratios), 2),
        "times_faster_each": [round(ratio, 2) for ratio in ratios],
    }
