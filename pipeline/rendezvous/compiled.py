"""Functions compiled by Numba, and where their machine code is kept from one run to the next.

Numba keeps it beside the source or in the user's cache and fails where it can write to neither: code
installed by someone else, no home directory, a read-only container. Then it is kept in a folder of
temporary files, or only in memory.
"""

from __future__ import annotations

import os
import stat
import tempfile
from contextlib import suppress
from functools import partial
from pathlib import Path

import numba
import numba.core.config


def _find_cache() -> bool:
    """Whether there is a folder for machine code; its name is left in the environment, for workers too."""
    source = Path(__file__).parent
    given = os.environ.get("NUMBA_CACHE_DIR")
    if given and _can_write(Path(given)):
        return True
    if _can_write(source) and _can_write(source / "geometry"):
        return True
    for folder in _private_folders():
        if _made_private(folder):
            os.environ["NUMBA_CACHE_DIR"] = numba.core.config.CACHE_DIR = str(folder)
            return True
    return False


def _can_write(folder: Path) -> bool:
    """Whether files can be made in `folder`, or in `__pycache__` below it where there is one."""
    cache = folder / "__pycache__"
    return os.access(cache if cache.is_dir() else folder, os.W_OK | os.X_OK)


def _private_folders() -> list[Path]:
    home = os.path.expanduser(os.environ.get("XDG_CACHE_HOME") or "~/.cache")
    folders = [Path(home, "rendezvous-numba")] if os.path.isabs(home) else []
    with suppress(FileNotFoundError):  # where no folder for temporary files can be written to
        folders.append(Path(tempfile.gettempdir(), f"rendezvous-numba-{os.geteuid()}"))
    return folders


def _made_private(folder: Path) -> bool:
    """Make `folder` unless it is there; whether it is ours alone. Machine code from others is not run."""
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        found = folder.lstat()
    except OSError:
        return False
    ours = stat.S_ISDIR(found.st_mode) and found.st_uid == os.geteuid() and not found.st_mode & 0o022
    return ours and os.access(folder, os.W_OK | os.X_OK)


njit = partial(numba.njit, cache=_find_cache())
"""`numba.njit` whose machine code is kept where that is possible."""
