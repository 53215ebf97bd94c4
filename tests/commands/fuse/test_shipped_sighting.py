"""The sighting that comes with the project, fused as its README says, with the weights that come with it."""

from __future__ import annotations

import json
import math
import re
import shlex
from pathlib import Path

import pytest
from typer.testing import CliRunner

from rendezvous.alignment.frame_error import pose_difference
from rendezvous.cli.__main__ import app
from rendezvous.geometry.se2 import SE2
from tests.conftest import ROOT

README = (ROOT / "assets" / "sighting" / "README.md").read_text()


def true_pose(words: str) -> SE2:
    """That the README tells after these words."""
    told = " ".join(README.split()).split(words)[1]
    x_m, y_m, yaw_deg = (float(number) for number in re.findall(r"-?\d+\.\d+", told)[:3])
    return SE2(x_m, y_m, math.radians(yaw_deg))


def test_it_is_fused_as_its_readme_says(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.chdir(tmp_path)  # where no weights of one's own lie
    (tmp_path / "assets").symlink_to(ROOT / "assets")
    (command,) = re.findall(r"\$ rendezvous (fuse .*?)\n```", README, re.DOTALL)
    shown = CliRunner().invoke(app, shlex.split(command.replace("\\\n", "")))
    assert shown.exit_code == 0, shown.output
    assert shown.stdout.startswith("accepted\n")
    told = json.loads((tmp_path / "fused" / "result.json").read_text())
    assert {Path(of["file"]).parent.name for of in told["weights"].values()} == {"weights"}
    seen = pose_difference(SE2(**told["sighting"][0]["T_r0_r1"]), true_pose("robot 1 stood at"))
    assert math.hypot(seen.x_m, seen.y_m) < 0.1
    assert abs(seen.yaw_rad) < math.radians(5.0)
    T_m1_r1 = SE2(0.820088, 1.83098, 2.50401)
    at = pose_difference(SE2(**told["T_m0_m1"]) @ T_m1_r1, true_pose("In truth map 1 lies at") @ T_m1_r1)
    assert math.hypot(at.x_m, at.y_m) < 0.04
    assert abs(at.yaw_rad) < math.radians(1.0)
