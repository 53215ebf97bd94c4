"""Shipped files, copied to be tried or changed."""

from __future__ import annotations

import shlex
from pathlib import Path

from typer.testing import CliRunner

from rendezvous.cli.__main__ import app
from rendezvous.config.load import load_config
from rendezvous.resources import STAGES_YAML
from rendezvous.robot_file import load_robot
from tests.cli.test_cli import rendezvous


def example(*arguments: str) -> list[str]:
    """What `rendezvous example` prints."""
    done = CliRunner().invoke(app, ["example", *arguments])
    assert done.exit_code == 0, done.output
    return shlex.split(done.stdout)


def test_the_sighting_comes_with_the_command_that_fuses_it(tmp_path: Path):
    folder = tmp_path / "a folder"
    words = example("sighting", "--out", str(folder))
    assert words[:2] == ["rendezvous", "fuse"]
    named = [Path(word) for word in words if word.startswith(str(folder))]
    assert [path.name for path in named] == ["map0.yaml", "map1.yaml", "image.jpg", "camera.yaml"]
    assert all(path.is_file() for path in named)
    assert example("sighting", "--out", str(folder)) == words


def test_stages_and_robot_are_those_that_are_shipped(tmp_path: Path):
    (stages,) = example("stages", "--out", str(tmp_path))
    assert load_config(stages) == load_config(STAGES_YAML)
    robot = next(
        path for path in example("robot", "--out", str(tmp_path / "robot")) if path.endswith(".yaml")
    )
    assert load_robot(robot) == load_robot("burger")
    assert Path(robot).with_suffix(".glb").is_file()


def test_a_changed_copy_is_not_replaced(tmp_path: Path):
    (tmp_path / "stages.yaml").write_text("seed: 1")
    shown = rendezvous("example", "stages", "--out", str(tmp_path))
    assert shown.returncode == 2
    assert "stages.yaml: exists and is not the shipped file" in shown.stderr
    assert (tmp_path / "stages.yaml").read_text() == "seed: 1"
