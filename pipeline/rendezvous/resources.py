"""Where the shipped files lie: `stages.yaml`, `assets/` and `floorplans/`.

A wheel carries them beside the code; a checkout has them at its top.
"""

from __future__ import annotations

from pathlib import Path

_PACKAGE = Path(__file__).parent
_CARRIED = _PACKAGE / "shipped"

ROOT = _CARRIED if _CARRIED.is_dir() else _PACKAGE.parents[1]
"""Folder of `stages.yaml`, `assets/` and `floorplans/`."""

ROBOTS = ROOT / "assets" / "robots"
WEIGHTS = ROOT / "assets" / "weights"
METRICS = ROOT / "assets" / "metrics"
SIGHTING = ROOT / "assets" / "sighting"
