"""The `explore` stage with one worker and with two, in turn."""

from __future__ import annotations

import argparse
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from benchmarks.scene import ROOT

REPEATS = 2
_SETTINGS = ["--set", "floorplans.generate.count=0", "--set", "explore.episodes_per_plan=4"]


def measure(options: argparse.Namespace) -> dict[str, Any]:
    """Seconds, and how many times two workers are faster: the median of runs side by side."""
    with tempfile.TemporaryDirectory() as data:
        for stage in ("floorplans", "meshes"):
            _stage(stage, data, 1)
        times_s: dict[int, list[float]] = {1: [], 2: []}
        for _ in range(REPEATS):
            for workers in (1, 2):
                shutil.rmtree(Path(data, "explore"), ignore_errors=True)
                started_s = time.perf_counter()
                _stage("explore", data, workers)
                times_s[workers].append(time.perf_counter() - started_s)
    ratios = [one / two for one, two in zip(times_s[1], times_s[2], strict=True)]
    return {
        "one_worker_s": round(statistics.median(times_s[1]), 1),
        "two_workers_s": round(statistics.median(times_s[2]), 1),
        "times_faster": round(statistics.median(ratios), 2),
        "times_faster_each": [round(ratio, 2) for ratio in ratios],
    }


def _stage(stage: str, data: str, workers: int) -> None:
    command = [sys.executable, "-m", "rendezvous.cli", stage, "--data", data, "--workers", str(workers)]
    subprocess.run([*command, *_SETTINGS], cwd=ROOT, check=True, stderr=subprocess.DEVNULL)
