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
LIDARS = ROOT / "assets" / "lidars"
WEIGHTS = ROOT / "assets" / "weights"
METRICS = ROOT / "assets" / "metrics"
SIGHTING = ROOT / "assets" / "sighting"
STAGES_YAML = ROOT / "stages.yaml"


def located(name: str) -> Path:
    """The path `name`; where nothing is there, the shipped file or folder of that name."""
    given = Path(name)
    if exists(given) or given.is_absolute() or ".." in given.parts:
        return given
    return shipped if exists(shipped := ROOT / given) else given


def exists(path: Path) -> bool:
    """Whether there is a file or folder of this name, which may be one that no file can have."""
    try:
        return path.exists()
    except (OSError, ValueError):  # too long, or with a zero byte or half a character
        return False
