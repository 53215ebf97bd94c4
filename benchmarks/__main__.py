"""`make bench`: measure and print one JSON object. Ratios carry over to other machines, figures do not."""

from __future__ import annotations

import argparse
import json
import os
import platform
import sys
from importlib import import_module

BENCHMARKS = (
    "startup",
    "episodes",
    "lidar",
    "planning",
    "scaling",
    "memory",
    "rendering",
    "baselines",
    "training",
    "fuse",
    "robot_shape",
    "slam",
)


def main() -> None:
    """Run all benchmarks, or those named."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks", description=__doc__)
    parser.add_argument("names", nargs="*", help=f"any of {', '.join(BENCHMARKS)}; all by default")
    parser.add_argument("--episodes", type=int, default=40, help="episodes to time")
    parser.add_argument("--memory-episodes", type=int, default=200, help="short episodes of the memory test")
    parser.add_argument("--images", type=int, default=96, help="images to time")
    parser.add_argument("--memory-images", type=int, default=200, help="images of the memory test")
    options = parser.parse_args()
    if unknown := sorted(set(options.names) - set(BENCHMARKS)):
        parser.error(f"no benchmark {', '.join(unknown)}; there are {', '.join(BENCHMARKS)}")
    results: dict[str, object] = {
        "machine": {"cores": len(os.sched_getaffinity(0)), "cpu": _cpu(), "python": platform.python_version()}
    }
    os.environ.setdefault("OMP_WAIT_POLICY", "passive")  # as the command line sets it for PyTorch
    for name in options.names or BENCHMARKS:
        print(f"{name} ...", file=sys.stderr, flush=True)
        results[name] = import_module(f"benchmarks.{name}").measure(options)
    print(json.dumps(results, indent=2))


def _cpu() -> str:
    with open("/proc/cpuinfo") as lines:
        return next(
            (line.split(":")[1].strip() for line in lines if line.startswith("model name")), "unknown"
        )


if __name__ == "__main__":
    main()
