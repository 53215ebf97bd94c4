"""The wheel works where there is no checkout."""

from __future__ import annotations

import os
import shlex
import shutil
import subprocess
import sys
import sysconfig
import tarfile
from pathlib import Path

import pytest

from tests.conftest import ROOT

pytestmark = pytest.mark.slow

THREE_PLANS = (
    "floorplans.sources=[floorplans/rdv-000.json, floorplans/rdv-001.json, floorplans/rdv-002.json]",
    "floorplans.generate.count=0",
    "explore.episodes_per_plan=1",
    "render.poses_per_plan=1",
    "pack={validation_fraction: 0.34, test_fraction: 0.34}",
)


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of an sdist and of the wheel that is built from it."""
    pytest.importorskip("build")
    pytest.importorskip("hatchling")
    folder = tmp_path_factory.mktemp("dist")
    done = subprocess.run(
        [sys.executable, "-m", "build", "--no-isolation", "--outdir", str(folder), str(ROOT)],
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return folder


@pytest.fixture(scope="module")
def bin_folder(built: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The commands of an environment with the wheel and all packages of this one but the checkout."""
    environment = tmp_path_factory.mktemp("installed") / "venv"
    subprocess.run([sys.executable, "-m", "venv", "--without-pip", str(environment)], check=True)
    (wheel,) = built.glob("*.whl")
    pip = [sys.executable, "-m", "pip", "--disable-pip-version-check", "--python", str(environment)]
    subprocess.run([*pip, "install", "-q", "--no-deps", "--no-index", str(wheel)], check=True)
    packages = environment / Path(sysconfig.get_path("purelib")).relative_to(sys.prefix)
    # A path file's own path files are not read: the one of an editable install stays without effect.
    (packages / "others.pth").write_text(
        f"{sysconfig.get_path('purelib')}\n{sysconfig.get_path('platlib')}\n"
    )
    _copy_machine_code(packages / "rendezvous")
    return environment / "bin"


def _copy_machine_code(installed: Path) -> None:
    """Copy what Numba has compiled already; it is used where the source is the same."""
    checkout = ROOT / "pipeline" / "rendezvous"
    for file in checkout.rglob("__pycache__/*.nb?"):
        target = installed / file.relative_to(checkout)
        target.parent.mkdir(exist_ok=True)
        shutil.copyfile(file, target)


def test_the_sdist_holds_what_the_tests_need(built: Path):
    (sdist,) = built.glob("*.tar.gz")
    with tarfile.open(sdist) as archive:
        names = {name.partition("/")[2] for name in archive.getnames()}
    assert names.issuperset(("stages.yaml", "constraints.txt", "tests/golden.json", "benchmarks/fuse.py"))
    assert {f"floorplans/rdv-{index:03d}.json" for index in range(24)} < names


def test_from_an_empty_folder_the_wheel_fuses_makes_a_dataset_and_measures_on_it(
    bin_folder: Path, tmp_path: Path
):
    pytest.importorskip("torch")
    environment = {key: value for key, value in os.environ.items() if key != "PYTHONPATH"}

    def run(program: str, *arguments: str) -> subprocess.CompletedProcess:
        command = [str(bin_folder / program), *arguments]
        return subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True)

    def rendezvous(*arguments: str) -> str:
        done = run("rendezvous", *arguments)
        assert done.returncode == 0, done.stderr
        return done.stdout

    found = run("python", "-c", "import rendezvous; print(rendezvous.__file__)").stdout
    assert found.startswith(str(bin_folder.parent))

    fuse = shlex.split(rendezvous("example", "sighting"))
    assert rendezvous(*fuse[1:]).startswith("accepted\n")
    assert (tmp_path / "fused" / "fused.yaml").is_file()

    sets = [word for item in THREE_PLANS for word in ("--set", item)]
    rendezvous("dataset", "--preset", "smoke", "--engine", "inline", *sets)
    assert rendezvous("verify").endswith(": sound\n")

    few = ("--count", "1", "--methods", "none", "--workers", "1")
    page = rendezvous("evaluate-fusion", *few).strip()
    assert "fusion" in (tmp_path / page).read_text(encoding="utf-8").lower()

    refused = run("rendezvous", "evaluate-fusion", "--record")
    assert (refused.returncode, refused.stderr.count("\n")) == (2, 1)
    assert "--records names another folder" in refused.stderr
