"""Memory of one worker over many short episodes."""

from __future__ import annotations

import argparse
import multiprocessing
import resource
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from typing import Any

import psutil

from benchmarks.episodes import short_episodes


def measure(options: argparse.Namespace) -> dict[str, Any]:
    """Resident memory after each tenth of the episodes, and its peak [MiB]."""
    with ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as worker:
        return worker.submit(mib_each_tenth, short_episodes, options.memory_episodes).result()


def mib_each_tenth(work: Callable[[int, int], object], count: int) -> dict[str, Any]:
    """Memory of this process while it calls `work(first, count)` for each tenth of `count`."""
    samples = []
    for tenth in range(10):
        work(tenth * count // 10, count // 10)
        samples.append(round(psutil.Process().memory_info().rss / 2**20, 1))
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**10
    return {"count": count, "rss_mib_each_tenth": samples, "peak_rss_mib": round(peak, 1)}
