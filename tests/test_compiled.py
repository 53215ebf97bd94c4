"""Machine code is kept where only its user can write, or not at all."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import numba.core.config
import pytest

import rendezvous
from rendezvous import compiled

NOBODY = 65534


@pytest.fixture
def folders(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> tuple[Path, Path]:
    """Folders for the user's cache and for temporary files, where the code cannot be written to."""
    home, temporary = tmp_path / "home", tmp_path / "tmp"
    temporary.mkdir()
    monkeypatch.setattr(compiled, "_can_write", lambda folder: False)
    monkeypatch.setattr(tempfile, "tempdir", str(temporary))
    monkeypatch.setattr(numba.core.config, "CACHE_DIR", "")
    monkeypatch.setenv("NUMBA_CACHE_DIR", "")
    monkeypatch.setenv("HOME", str(home))
    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    return home / ".cache" / "rendezvous-numba", temporary / f"rendezvous-numba-{os.geteuid()}"


def kept_in() -> tuple[bool, str, str]:
    """Whether machine code is kept, and where workers and Numba look for it."""
    return compiled._find_cache(), os.environ["NUMBA_CACHE_DIR"], numba.core.config.CACHE_DIR


def test_code_that_can_be_written_to_keeps_its_own(folders, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(compiled, "_can_write", lambda folder: True)
    assert kept_in() == (True, "", "")


def test_otherwise_it_is_kept_in_a_private_folder_of_the_users_cache(folders):
    in_home, _ = folders
    assert kept_in() == (True, str(in_home), str(in_home))
    assert in_home.stat().st_mode & 0o777 == 0o700


def test_without_a_home_it_is_kept_among_temporary_files(folders, monkeypatch: pytest.MonkeyPatch):
    _, in_tmp = folders
    monkeypatch.setenv("HOME", "/proc/no/such/home")
    assert kept_in() == (True, str(in_tmp), str(in_tmp))


@pytest.mark.parametrize("trap", ["writable", "link", "file", "foreign"])
def test_a_folder_that_others_may_have_filled_is_not_used(
    folders, monkeypatch: pytest.MonkeyPatch, trap: str
):
    _, in_tmp = folders
    monkeypatch.setenv("HOME", "/proc/no/such/home")
    in_tmp.mkdir(mode=0o700)
    match trap:
        case "writable":
            in_tmp.chmod(0o770)
        case "link":
            in_tmp.rename(in_tmp.with_name("theirs"))
            in_tmp.symlink_to(in_tmp.with_name("theirs"))
        case "file":
            in_tmp.rmdir()
            in_tmp.touch()
        case "foreign":
            other = os.geteuid() + 1
            monkeypatch.setattr(os, "geteuid", lambda: other)
            in_tmp.rename(in_tmp.with_name(f"rendezvous-numba-{other}"))
    assert kept_in() == (False, "", "")


@pytest.fixture
def nobodys() -> Iterator[Path]:
    """A folder of a user who owns nothing else."""
    if os.geteuid() != 0:
        pytest.skip("only root can run a command as another user")
    folder = Path(tempfile.mkdtemp())
    os.chown(folder, NOBODY, NOBODY)
    yield folder
    shutil.rmtree(folder)


@pytest.mark.slow
def test_a_user_without_a_home_runs_code_that_he_cannot_write_to(nobodys: Path):
    environment = {
        "PATH": os.environ["PATH"],
        "PYTHONPATH": str(Path(rendezvous.__file__).parents[1]),
        "TMPDIR": str(nobodys),
    }

    def as_nobody(*arguments: str) -> subprocess.CompletedProcess:
        command = [sys.executable, *arguments]
        options = {"user": NOBODY, "group": NOBODY, "extra_groups": [], "cwd": nobodys, "env": environment}
        return subprocess.run(command, capture_output=True, text=True, **options)

    try:
        as_nobody("-c", "import rendezvous").check_returncode()
    except (OSError, subprocess.CalledProcessError):
        pytest.skip("others may not read this checkout or its Python")
    one_plan = ("--set", "floorplans.sources=[]", "--set", "floorplans.generate.count=1")
    done = as_nobody("-m", "rendezvous", "floorplans", "--preset", "smoke", "--workers", "1", *one_plan)
    assert done.returncode == 0, done.stderr
    assert list((nobodys / f"rendezvous-numba-{NOBODY}").rglob("*.nbi"))
