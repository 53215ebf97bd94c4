"""Where the shipped files lie: `stages.yaml`, `assets/` and `floorplans/`.

A wheel carries them beside the code; a checkout has them at its top.
"""

from __future__ import annotations

from pathlib import Path

_PACKAGE = Path(__file__).parent
_CARRIED = _PACKAGE / "shipped"

IN_CHECKOUT = not _CARRIED.is_dir()
ROOT = _PACKAGE.parents[1] if IN_CHECKOUT else _CARRIED  # of `stages.yaml`, `assets/` and `floorplans/`

ROBOTS = ROOT / "assets" / "robots"
WEIGHTS = ROOT / "assets" / "weights"
METRICS = ROOT / "assets" / "metrics"
SIGHTING = ROOT / "assets" / "sighting"
STAGES_YAML = ROOT / "stages.yaml"


def located(name: str) -> Path:
    """The path `name`; where nothing is there, the shipped file or folder of that name."""
    given = Path(name)
    if given.exists() or given.is_absolute() or ".." in given.parts:
        return given
    return shipped if (shipped := ROOT / given).exists() else given
