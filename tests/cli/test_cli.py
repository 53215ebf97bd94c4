"""The command line as a user meets it: mostly in a process of its own."""

from __future__ import annotations

import os
import resource
import signal
import subprocess
import sys
from functools import partial
from pathlib import Path

import pytest

from rendezvous.cli.__main__ import main
from rendezvous.store.verify import verify
from tests.conftest import ROOT, wait_until
from tests.toy_stage import folder_content

STAGES = ("floorplans", "meshes", "explore", "render", "pack", "dataset")
COMMANDS = (*STAGES, "train", "evaluate", "fuse", "verify", "inspect", "export")


def command(*arguments: str) -> list[str]:
    return [sys.executable, "-m", "rendezvous.cli", *arguments]


def rendezvous(*arguments: str, **options) -> subprocess.CompletedProcess:
    return subprocess.run(command(*arguments), cwd=ROOT, capture_output=True, text=True, **options)


INLINE = ("--engine", "inline")


def generate(data: Path, *, count: int = 4, more: tuple[str, ...] = ()) -> tuple[str, ...]:
    """Arguments that generate plans, one per shard."""
    sets = ("sources=[]", f"generate.count={count}", "plans_per_shard=1", "generate.plans.rooms=[3, 5]")
    overrides = [word for item in sets for word in ("--set", f"floorplans.{item}")]
    return ("floorplans", "--preset", "smoke", "--data", str(data), *overrides, *more)


def test_help_names_all_commands():
    shown = rendezvous("--help")
    assert shown.returncode == 0
    for name in COMMANDS:
        assert name in shown.stdout


def test_the_version_is_that_of_the_package():
    shown = rendezvous("--version")
    assert shown.returncode == 0
    assert f'version = "{shown.stdout.split()[1]}"' in (ROOT / "pyproject.toml").read_text()


def test_help_imports_nothing_heavy():
    heavy = "('numpy', 'pyarrow', 'pydantic')"
    code = f"import sys, rendezvous.cli.__main__; print([m for m in {heavy} if m in sys.modules])"
    shown = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True)
    assert shown.stdout == "[]\n"


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_explains_itself(name: str):
    assert rendezvous(name, "--help").returncode == 0


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("meshes", "--set", "meshes.wall_height=3"), "the nearest known key is 'meshes.wall_height_m'"),
        (("meshes", "--preset", "huge"), "presets are smoke, default, poses, maps, pathtraced, large, paper"),
        (("meshes", "--engine", "spark"), "--engine is 'spark'; must be one of local, inline, ray"),
        (("meshes", "--config", "nowhere.yaml"), "nowhere.yaml: no such file or directory"),
        (("meshes", "--data", ""), "--data is ''; must name a folder or be a URI"),
        (("export", "plan", "x", "--data", " "), "--data is ' '; must name a folder or be a URI"),
        (("meshes", "--seed", "9" * 20), f"must be less than or equal to {2**63 - 1}"),
        (("meshes", "--config", sys.executable), "not text in UTF-8"),
        (("meshes", "--data", "nowhere"), "nowhere/floorplans: no manifest.json"),
        (("verify", "nowhere"), "nowhere: no stage's output here"),
        (("inspect", "nowhere"), "nowhere: no manifest.json"),
        (("export", "plan", "x", "--data", "nowhere"), "nowhere/meshes: no manifest.json"),
    ],
)
def test_what_the_user_can_fix_is_one_line_and_exit_2(
    arguments: tuple[str, ...],
    said: str,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
):
    monkeypatch.chdir(ROOT)
    monkeypatch.setattr(sys, "argv", ["rendezvous", *arguments])
    with pytest.raises(SystemExit) as ended:
        main()
    shown = capsys.readouterr().err
    assert ended.value.code == 2
    assert shown.count("\n") == 1
    assert shown.startswith("rendezvous: ")
    assert said in shown


def test_a_bug_keeps_its_traceback(tmp_path: Path):
    code = (
        "import rendezvous.cli.__main__ as cli, rendezvous.config.load as c; c.load_config = None; cli.main()"
    )
    shown = subprocess.run([sys.executable, "-c", code, "meshes"], cwd=ROOT, capture_output=True, text=True)
    assert shown.returncode == 1
    assert shown.stderr.startswith("Traceback (most recent call last)")
    assert "TypeError: 'NoneType' object is not callable" in shown.stderr


def test_verify_says_sound_and_then_names_the_fault(tmp_path: Path):
    assert rendezvous(*generate(tmp_path, more=INLINE)).returncode == 0
    shown = rendezvous("verify", str(tmp_path))
    assert (shown.returncode, shown.stdout) == (0, f"{tmp_path}/floorplans: sound\n")
    part = tmp_path / "floorplans" / "part-00002.parquet"
    part.write_bytes(part.read_bytes()[:-1])
    shown = rendezvous("verify", str(tmp_path))
    assert shown.returncode == 1
    assert shown.stdout.startswith(f"{part}: file truncated")


def test_verify_goes_on_after_a_damaged_manifest(tmp_path: Path):
    assert rendezvous(*generate(tmp_path, more=INLINE)).returncode == 0
    broken = tmp_path / "broken" / "manifest.json"
    broken.parent.mkdir()
    broken.write_text("[")
    part = tmp_path / "floorplans" / "part-00002.parquet"
    part.unlink()
    shown = rendezvous("verify", str(tmp_path))
    assert shown.returncode == 1
    first, second = shown.stdout.splitlines()
    assert first.startswith(f"{broken}: damaged")
    assert second == f"{part}: file missing"


def test_a_plan_is_exported_from_where_meshes_writes(tmp_path: Path):
    config = tmp_path / "stages.yaml"
    config.write_text((ROOT / "stages.yaml").read_text().replace("writes: meshes", "writes: solids"))
    shown = rendezvous("export", "plan", "x", "--data", "nowhere", "--config", str(config))
    assert shown.returncode == 2
    assert "nowhere/solids: no manifest.json" in shown.stderr


@pytest.mark.slow
def test_ctrl_c_leaves_a_folder_that_the_next_run_completes(tmp_path: Path):
    arguments = generate(tmp_path / "cut", count=30, more=("--workers", "2"))
    # Started in the background, a shell's child ignores the signal, and its children with it.
    listening = partial(signal.signal, signal.SIGINT, signal.SIG_DFL)
    process = subprocess.Popen(
        command(*arguments),
        cwd=ROOT,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        preexec_fn=listening,
    )
    folder = tmp_path / "cut" / "floorplans"
    wait_until(lambda: len(list(folder.glob("part-*.parquet"))) >= 3, process)
    os.killpg(process.pid, signal.SIGINT)  # as a terminal does: to all processes of the group
    *progress, last = process.communicate()[1].splitlines()
    assert process.returncode == 130
    assert last == "rendezvous: interrupted; what was finished is kept: run the same command again to go on"
    assert all(line.startswith("floorplans: ") for line in progress)  # where making them takes long
    assert not [name for name in folder_content(folder) if ".tmp-" in name]
    assert not (folder / "manifest.json").exists()
    resumed = rendezvous(*arguments)
    assert resumed.returncode == 0
    assert "30 made" not in resumed.stderr
    assert rendezvous(*generate(tmp_path / "whole", count=30, more=INLINE)).returncode == 0
    assert folder_content(folder) == folder_content(tmp_path / "whole" / "floorplans")


@pytest.mark.parametrize("engine", ["local", "inline"])
def test_a_file_that_cannot_be_written_in_full_is_one_line(tmp_path: Path, engine: str):
    # A limit on the size of files stands in for a full disk: the write fails half-way.
    limited = partial(resource.setrlimit, resource.RLIMIT_FSIZE, (5000, 5000))
    arguments = generate(tmp_path, more=("--engine", engine))
    shown = rendezvous(*arguments, preexec_fn=limited)
    assert shown.returncode == 2
    assert shown.stderr.count("\n") == 1
    assert "part-0000" in shown.stderr
    assert ": file too large" in shown.stderr
    assert not [name for name in folder_content(tmp_path) if ".tmp-" in name]
    assert rendezvous(*arguments).returncode == 0
    assert verify(str(tmp_path / "floorplans")) == []
