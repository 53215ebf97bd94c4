"""Physics runs whatever the environment says about drawing."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest


@pytest.mark.parametrize("renderer", ["osmesa", "no such renderer"])
def test_physics_needs_no_renderer_and_leaves_the_choice_of_one_alone(renderer: str):
    code = "import os, rendezvous.simulation.drive; print(os.environ['MUJOCO_GL'])"
    done = subprocess.run(
        [sys.executable, "-c", code],
        env={**os.environ, "MUJOCO_GL": renderer},
        capture_output=True,
        text=True,
    )
    assert (done.stdout, done.stderr) == (f"{renderer}\n", "")
