"""What would stop `dataset` in its last stages is told before the long ones begin."""

from __future__ import annotations

from pathlib import Path

import pytest
from typer.testing import CliRunner

from rendezvous.cli.__main__ import app
from tests.conftest import ROOT


def dataset(data: Path, *overrides: str) -> tuple[int, str]:
    sets = [word for override in overrides for word in ("--set", override)]
    shown = CliRunner().invoke(
        app,
        ["dataset", "--preset", "smoke", "--config", str(ROOT / "stages.yaml"), "--data", str(data), *sets],
    )
    return shown.exit_code, shown.stderr


def test_too_few_floor_plans_are_told_before_robots_drive(tmp_path):
    sources = f"floorplans.sources=[{ROOT}/floorplans/rdv-001.json]"
    code, told = dataset(tmp_path, sources, "floorplans.generate.count=0", "render.views=false",
                         "render.poses_per_plan=0")  # fmt: skip
    assert code == 2
    assert "would be empty: 1 floor plans" in told
    assert "one of them 1 and the other 0 publish all as one split" in told
    assert [path.name for path in tmp_path.iterdir()] == ["floorplans"]


@pytest.mark.parametrize("pictured", [True, False])
def test_a_robot_without_a_model_is_told_before_anything_is_made(tmp_path, pictured):
    robot = tmp_path / "plain.yaml"
    robot.write_text((ROOT / "assets" / "robots" / "burger" / "robot.yaml").read_text())
    data = tmp_path / "data"
    code, told = dataset(
        data,
        f"explore.robot={robot}",
        "floorplans.sources=[]",
        "floorplans.generate.count=1",
        f"render.views={str(pictured).lower()}",
        "render.poses_per_plan=0",
    )
    assert code == 2
    assert ("no model" in told) is pictured
    assert data.exists() is not pictured
