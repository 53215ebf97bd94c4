from __future__ import annotations

import re
import subprocess
import sys
import tomllib
from pathlib import Path
from types import SimpleNamespace

import pytest
from rendezvous.commands.export.sighting import export_sighting
from rendezvous.config.sections import TrainSection
from rendezvous.documentation import documented
from rendezvous.geometry.se2 import SE2
from rendezvous.resources import ROOT
from rendezvous.robot_file import load_robot
from rendezvous.schema import PAIRS, POSES
from rendezvous.stages.pack import pack
from rendezvous.stages.weights.pose_source import PoseWeights

from tests.commands.fuse.test_fuse import Seeing
from tests.synthetic_dataset import explored, synthetic_run

README = (ROOT / "README.md").read_text()
FUSE_EXAMPLE, *EXAMPLES = re.findall(r"```python\n(.*?)```", README, re.DOTALL)


def test_the_readme_says_what_the_code_says():
    assert documented(README) == README, "run `python -m rendezvous.documentation`"
    assert all(f"| `{column.name}` |" in README for column in (*PAIRS.columns, *POSES.columns))


def test_the_table_of_stages_says_that_weights_lie_beside_the_data():
    (train,) = (line for line in README.splitlines() if line.startswith("| [`train`]"))
    assert "| `data/dataset/` | `runs/` |" in train


def test_every_file_that_the_readme_links_to_exists():
    links = re.findall(r"\]\(([^)#]+)\)", README)
    assert len(links) > 5
    assert [link for link in links if not link.startswith("http") and not (ROOT / link).exists()] == []


def test_contributors_find_parameters_where_they_are_told():
    told = (ROOT / "CONTRIBUTING.md").read_text()
    (named,) = re.findall(r"section in `(pipeline/rendezvous/[\w/]+\.py)`", told)
    assert named == f"pipeline/{TrainSection.__module__.replace('.', '/')}.py"
    rooms = re.findall(r"`(\w+)`", re.findall(r"\*\*Rooms\*\* \((.*?)\)", told)[0])
    layers = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["importlinter"]["contracts"][0]
    packages = {path.parent.name for path in (ROOT / "pipeline" / "rendezvous").glob("*/__init__.py")}
    below_stages = {name for line in layers["layers"][4:] for name in re.findall(r"\w+", line)} & packages
    assert set(rooms) == below_stages - {"store", "interop"}  # which deal with files


def test_the_pictures_suit_a_readme():
    sizes = [path.stat().st_size for path in (ROOT / "docs" / "images").iterdir()]
    assert len(sizes) == 3
    assert max(sizes) < 400_000


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("example")
    explored(folder / "data")
    pack(synthetic_run(folder / "data"))
    return folder


@pytest.mark.parametrize("example", EXAMPLES, ids=range(len(EXAMPLES)))
def test_the_examples_run(example, folder):
    done = subprocess.run(
        [sys.executable, "-c", example],
        env={"PATH": "", "HOME": str(folder), "HF_HOME": str(folder), "HF_DATASETS_OFFLINE": "1"},
        cwd=folder,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr[-2000:]


def test_the_example_of_fuse_runs_on_a_sighting_of_the_dataset(folder, monkeypatch, capsys):
    export_sighting(str(folder / "data" / "dataset"), None, folder / "report" / "sighting")
    monkeypatch.chdir(folder)
    # The synthetic picture shows no robot.
    seeing, cuboid = Seeing(SE2(1.0, 0.2, 2.0)), load_robot("burger").cuboid
    source = SimpleNamespace(
        path="weights.safetensors",
        digest="0" * 64,
        estimator=lambda *, floor: seeing,
        record=lambda: {"robot": {"size_m": cuboid.size_m, "T_r1_o": cuboid.T_r_o()}},
    )
    monkeypatch.setattr(PoseWeights, "found", lambda path: source)
    exec(FUSE_EXAMPLE, {})
    assert re.match(r"SE2\(x_m=.*\) (accepted|uncertain: )", capsys.readouterr().out)


def test_there_is_an_example_for_every_program():
    assert [example.split()[1] for example in EXAMPLES] == ["datasets", "duckdb", "polars", "pathlib"]
