"""`import rendezvous`: light, and deaf to the files beside a user's script."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

import rendezvous
from rendezvous.config.stage_table import DATASET_STAGES

HEAVY = ("numpy", "torch", "mujoco", "numba", "pyarrow", "cv2", "pydantic", "typer")


def run(*arguments: str, cwd: Path, **environment: str) -> str:
    done = subprocess.run(
        [sys.executable, *arguments], cwd=cwd, capture_output=True, text=True, env=environment
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_importing_the_package_imports_nothing_heavy(tmp_path: Path):
    code = f"import sys, rendezvous; print([name for name in {HEAVY} if name in sys.modules])"
    assert run("-c", code, cwd=tmp_path, **paths()) == "[]\n"


@pytest.mark.parametrize("name", rendezvous.__all__)
def test_each_public_name_is_there(name: str):
    pytest.importorskip("torch")
    assert getattr(rendezvous, name) is not None
    assert name in dir(rendezvous)


def test_another_name_is_an_attribute_error():
    with pytest.raises(AttributeError, match="module 'rendezvous' has no attribute 'fuze'"):
        _ = rendezvous.fuze


def test_files_of_a_user_named_like_our_folders_change_nothing(tmp_path: Path):
    for folder in (tmp_path, tmp_path / "path"):
        folder.mkdir(exist_ok=True)
        for name in ("pipeline", "stages", "config", "engine", "store", "schema", "errors", "fusion", "cli"):
            (folder / f"{name}.py").write_text(f"raise ImportError('{name}.py of the user')\n")
    (tmp_path / "script.py").write_text(
        "from rendezvous import SE2, fuse\nprint(SE2.identity().x_m, fuse.__name__)\n"
    )
    both = {"PYTHONPATH": f"{tmp_path / 'path'}:{paths()['PYTHONPATH']}"}
    assert run("script.py", cwd=tmp_path, **both) == "0.0 fuse\n"
    made = ("--preset", "smoke", "--set", "floorplans.sources=[]", "--set", "floorplans.generate.count=1")
    run("-m", "rendezvous", "floorplans", *made, "--workers", "1", cwd=tmp_path, **both)
    assert (tmp_path / "data" / "floorplans" / "manifest.json").is_file()


def paths() -> dict[str, str]:
    """Where this package lies, for a process whose working folder is another."""
    return {"PYTHONPATH": str(Path(rendezvous.__file__).parents[1])}


@pytest.mark.slow
def test_without_the_extras_data_is_made_and_read(tmp_path: Path):
    extras = (
        "torch",
        "safetensors",
        "tensorboard",
        "matplotlib",
        "seaborn",
        "pandas",
        "jinja2",
        "ray",
        "bpy",
    )
    modules = [f"rendezvous.stages.{name}" for name in DATASET_STAGES]
    modules += ["rendezvous.commands.inspect", "rendezvous.commands.fuse.from_python"]
    modules += ["rendezvous.training.frame_error.pairs"]
    modules += [f"rendezvous.commands.export.{name}" for name in ("plan", "bop", "dope")]
    without = f"import sys; sys.modules.update(dict.fromkeys({extras}))"
    run("-c", f"{without}; import {', '.join(modules)}", cwd=tmp_path, **paths())
