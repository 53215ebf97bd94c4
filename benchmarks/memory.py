"""Memory of one worker over many short episodes."""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from typing import Any

from benchmarks.scene import ROOT

_MANY = """
import dataclasses, json, sys
import psutil
from benchmarks import scene
from benchmarks.episodes import _run

section = scene.default_config().explore
short = dataclasses.replace(section.episode, max_time_s=15.0, first_event_s=(3.0, 8.0))
object.__setattr__(section, "episode", short)
process, count = psutil.Process(), int(sys.argv[1])
samples = []
for tenth in range(10):
    _run(tenth * count // 10, count // 10, drive="wheels")
    samples.append(round(process.memory_info().rss / 2**20, 1))
import resource
peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**10
print(json.dumps({"episodes": count, "rss_mib_each_tenth": samples, "peak_rss_mib": round(peak, 1)}))
"""


def measure(options: argparse.Namespace) -> dict[str, Any]:
    """Resident memory after each tenth of the episodes, and its peak [MiB]."""
    command = [sys.executable, "-c", _MANY, str(options.memory_episodes)]
    done = subprocess.run(command, cwd=ROOT, check=True, stdout=subprocess.PIPE, text=True)
    return dict(json.loads(done.stdout))
