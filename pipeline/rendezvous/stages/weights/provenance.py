"""The code, packages and machine behind measured figures."""

from __future__ import annotations

import os
import platform
import subprocess
from collections.abc import Iterable
from contextlib import suppress
from importlib import metadata
from pathlib import Path

from rendezvous.resources import IN_CHECKOUT, ROOT


def commit() -> str:
    """The code's commit, marked if files differ from it; '' outside a git checkout."""
    if not IN_CHECKOUT:
        return ""
    git = ["git", "-C", str(ROOT), "describe", "--always", "--abbrev=40", "--exclude=*", "--dirty=+changes"]
    try:
        return subprocess.run(git, capture_output=True, text=True, check=True).stdout.strip()
    except (OSError, subprocess.CalledProcessError):
        return ""


def hardware() -> str:
    """Cores and processor, such as `2 cores of Intel(R) Xeon(R) CPU @ 2.20GHz`."""
    info = Path("/proc/cpuinfo")
    lines = info.read_text(encoding="utf-8").splitlines() if info.is_file() else []
    models = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
    model = models[0] if models else platform.processor() or platform.machine()
    return f"{len(os.sched_getaffinity(0))} cores of {model}"


def versions(packages: Iterable[str]) -> dict[str, str]:
    """Versions of those of the packages that are installed, by name."""
    found = {}
    for name in packages:
        with suppress(metadata.PackageNotFoundError):
            found[name] = metadata.version(name)
    return found
