from __future__ import annotations

import re
import shlex
import subprocess
import sys
import tomllib
from pathlib import Path
from types import SimpleNamespace

import pytest
import yaml
from typer.testing import CliRunner

from rendezvous.cli.__main__ import app
from rendezvous.commands.export.sighting import export_sighting
from rendezvous.config.sections import TrainSection
from rendezvous.documentation import documented, pages
from rendezvous.geometry.se2 import SE2
from rendezvous.resources import ROOT
from rendezvous.robot_file import load_robot
from rendezvous.schema import PAIRS, POSES
from rendezvous.stages.pack import pack
from rendezvous.stages.weights.pose_source import PoseWeights
from rendezvous.store.read import StageReader
from tests.commands.fuse.test_fuse import Seeing
from tests.synthetic_dataset import explored, synthetic_run

PAGES = [
    ROOT / "README.md",
    ROOT / "CONTRIBUTING.md",
    ROOT / "examples" / "README.md",
    *(ROOT / "docs").glob("*.md"),
]
README = (ROOT / "README.md").read_text()
DATASET = (ROOT / "docs" / "dataset.md").read_text()
DATASET_EXAMPLES = re.findall(r"```python\n(.*?)```", DATASET, re.DOTALL)
(FUSE_EXAMPLE,) = re.findall(r"```python\n(.*?)```", (ROOT / "docs" / "fuse.md").read_text(), re.DOTALL)
EXAMPLES = ROOT / "examples"


def test_the_generated_parts_say_what_the_code_says():
    generated = pages()
    assert [page.name for page in generated] == ["README.md", "architecture.md", "dataset.md"]
    for page in generated:
        assert documented(page.read_text()) == page.read_text(), f"{page.name}: run `make docs`"
    assert all(f"| `{column.name}` |" in DATASET for column in (*PAIRS.columns, *POSES.columns))


def test_every_package_says_what_it_holds():
    inits = [init for init in (ROOT / "pipeline").rglob("__init__.py") if "shipped" not in init.parts]
    assert len(inits) > 30
    assert [str(init) for init in inits if not init.read_text().startswith('"""')] == []


def test_the_table_of_stages_says_that_weights_lie_beside_the_data():
    (train,) = (line for line in README.splitlines() if line.startswith("| [`train`]"))
    assert "| `data/dataset/` | `runs/` |" in train


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_every_file_that_a_page_links_to_exists(page):
    links = [
        link for link in re.findall(r"\]\(([^)#]+)[^)]*\)", page.read_text()) if not link.startswith("http")
    ]
    assert page.name in ("cluster.md", "fuse.md") or links
    assert [link for link in links if not (page.parent / link).exists()] == []


def test_the_readme_is_short_and_names_every_page():
    assert len(README.splitlines()) <= 170
    assert all(f"](docs/{page.name})" in README for page in (ROOT / "docs").glob("*.md"))


def test_contributors_find_parameters_where_they_are_told():
    told = (ROOT / "CONTRIBUTING.md").read_text()
    assert f"(pipeline/{TrainSection.__module__.replace('.', '/')}.py)" in told
    rooms = set(re.findall(r"`(\w+)`", re.findall(r"\*\*Rooms\*\* \((.*?)\)", told, re.DOTALL)[0]))
    layers = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["importlinter"]["contracts"][0][
        "layers"
    ]
    packages = {path.parent.name for path in (ROOT / "pipeline" / "rendezvous").glob("*/__init__.py")}
    shell = {"cli", "commands", "stages", "engine", "config"}
    below = {name for line in layers for name in re.findall(r"\w+", line)} & packages - shell
    assert rooms == below - {"store", "interop"}  # which deal with files


def test_the_changelog_and_the_citation_name_this_version():
    version = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["version"]
    assert f"## [{version}]" in (ROOT / "CHANGELOG.md").read_text()
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text())
    assert citation["version"] == version
    assert citation["license"] == "Apache-2.0"


def test_the_pictures_suit_a_readme():
    sizes = [path.stat().st_size for path in (ROOT / "docs" / "images").iterdir()]
    assert len(sizes) >= 3
    assert max(sizes) < 400_000


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("example")
    explored(folder / "data")
    pack(synthetic_run(folder / "data"))
    return folder


def _run(arguments, folder):
    done = subprocess.run(
        [sys.executable, *arguments],
        env={"PATH": "", "HOME": str(folder), "HF_HOME": str(folder), "HF_DATASETS_OFFLINE": "1"},
        cwd=folder,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr[-2000:]
    return done.stdout


@pytest.mark.parametrize("example", DATASET_EXAMPLES, ids=range(len(DATASET_EXAMPLES)))
def test_the_examples_of_the_dataset_run(example, folder):
    _run(["-c", example], folder)


def test_there_is_an_example_for_every_program():
    assert [example.split()[1] for example in DATASET_EXAMPLES] == ["datasets", "duckdb", "polars", "pathlib"]


def test_every_example_script_is_listed_and_run_here():
    scripts = {path.name for path in EXAMPLES.glob("*.py")}
    assert scripts == set(re.findall(r"\]\((\w+\.py)\)", (EXAMPLES / "README.md").read_text()))
    assert scripts == set(SAYS) | {"own_robot.py"}


SAYS = {
    "fuse_two_maps.py": r"verdict: accepted\n",
    "read_with_polars.py": r"wall_agreement_local",
    "plot_pair.py": r"overlap \d\.\d\d, range \d\.\d\d m: pair\.png",
    "train_your_own.py": r"epoch 1: train \d+\.\d+, validation \d+\.\d+",
    "own_estimator.py": r"index\.html",
}
"""What each script prints, among other things."""


@pytest.mark.slow
@pytest.mark.parametrize("script", SAYS)
def test_the_example_scripts_run(script, folder):
    arguments = ["data/dataset", "2"] if script == "train_your_own.py" else []
    assert re.search(SAYS[script], _run([str(EXAMPLES / script), *arguments], folder))


@pytest.mark.slow
def test_a_dataset_of_ones_own_robot_is_made_by_the_example(tmp_path):
    few = ["--set", "floorplans.generate.count=0", "--set", "render.poses_per_plan=1"]
    few += ["--set", "explore.episodes_per_plan=1", "--set", "explore.episode.max_time_s=60"]
    few += ["--engine", "inline"]
    _run([str(EXAMPLES / "own_robot.py"), *few], tmp_path)
    rows = StageReader(str(tmp_path / "data-courier" / "dataset")).rows(columns=["robot"])
    assert {row["robot"] for row in rows} == {"courier"}


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


def numbers(line: str) -> list[float]:
    return [float(number) for number in re.findall(r"-?\d+\.\d+", line)]


@pytest.mark.slow
def test_the_readme_fuses_the_shipped_sighting(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (console,) = re.findall(r"```console\n(\$ rendezvous example.*?)```", README, re.DOTALL)
    for command in re.findall(r"^\$ rendezvous ((?:.*\\\n)*.*)$", console, re.MULTILINE):
        shown = CliRunner().invoke(app, shlex.split(command.replace("\\\n", "")))
        assert shown.exit_code == 0, shown.output
    verdict, found = shown.stdout.splitlines()[:2]
    assert verdict == console.splitlines()[4]
    # Processors differ in the last bits.
    assert numbers(found) == pytest.approx(numbers(console.splitlines()[5]), abs=0.01)
    (example,) = re.findall(r"```python\n(.*?)```", README, re.DOTALL)
    exec(example, {})
    assert re.fullmatch(r"SE2\(x_m=-4\.8.*\) accepted\n", capsys.readouterr().out)
