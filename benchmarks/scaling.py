"""The `explore` stage with one worker and with two, in turn."""

from __future__ import annotations

import argparse
import statistics
import subprocess
import sys
import tempfile
import time
from typing import Any

from benchmarks.scene import ROOT

REPEATS = 3
_SETTINGS = ["--set", "floorplans.generate.count=0", "--set", "explore.episodes_per_plan=2"]


def measure(options: argparse.Namespace) -> dict[str, Any]:
    """Seconds, and how many times two workers are faster: the median of runs side by side."""
    with tempfile.TemporaryDirectory() as data:
        for stage in ("floorplans", "meshes"):
            _stage(stage, data, 1)
        times_s: dict[int, list[float]] = {1: [], 2: []}
        for repeat in range(REPEATS):
            for workers in (1, 2):
                started_s = time.perf_counter()
                _stage("explore", data, workers, f"--seed={repeat}")
                times_s[workers].append(time.perf_counter() - started_s)
    ratios = [one / two for one, two in zip(times_s[1], times_s[2], strict=True)]
    return {
        "one_worker_s": round(statistics.median(times_s[1]), 1),
        "two_workers_s": round(statistics.median(times_s[2]), 1),
        "times_faster": round(statistics.median(ratios), 2),
        "times_faster_each": [round(ratio, 2) for ratio in ratios],
    }


def _stage(stage: str, data: str, workers: int, *options: str) -> None:
    command = [sys.executable, "-m", "pipeline.cli", stage, "--data", data, "--workers", str(workers)]
    subprocess.run([*command, *_SETTINGS, *options], cwd=ROOT, check=True, stderr=subprocess.DEVNULL)
