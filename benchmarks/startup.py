"""From the command to the first simulated second, with machine code in its cache."""

from __future__ import annotations

import argparse
import statistics
import subprocess
import sys
import time
from typing import Any

from benchmarks.scene import ROOT

_FIRST_SECOND = "from benchmarks.episodes import short_episodes; short_episodes(0, 1, max_time_s=1.0)"


def measure(options: argparse.Namespace) -> dict[str, Any]:
    """Median seconds of three runs after one that fills the cache."""
    commands = {
        "help_s": ["-m", "rendezvous.cli", "--help"],
        "first_simulated_second_s": ["-c", _FIRST_SECOND],
    }
    return {name: round(_median_s([sys.executable, *command]), 2) for name, command in commands.items()}


def _median_s(command: list[str]) -> float:
    times_s = []
    for _ in range(4):
        started_s = time.perf_counter()
        subprocess.run(command, cwd=ROOT, check=True, stdout=subprocess.DEVNULL)
        times_s.append(time.perf_counter() - started_s)
    return statistics.median(times_s[1:])
