"""The sheet of a robot's family: the first as built, all in frame, drawn anew for each seed."""

import cv2
import numpy as np
from typer.testing import CliRunner

from rendezvous.cli.__main__ import app
from rendezvous.commands.robot_sheet import COLUMNS, PAPER, TILE_PX, robot_sheet
from rendezvous.rendering.draws import RobotDraws


def test_robots_fill_rows_of_eight_and_the_rest_is_paper():
    sheet = robot_sheet("burger", RobotDraws(), count=9, seed=0)
    assert sheet.shape == (2 * TILE_PX, COLUMNS * TILE_PX, 3)
    tiles = [
        sheet[r : r + TILE_PX, c : c + TILE_PX]
        for r in (0, TILE_PX)
        for c in range(0, sheet.shape[1], TILE_PX)
    ]
    drawn = [(np.abs(tile.astype(int) - PAPER).max(axis=2) > 20).mean() for tile in tiles]
    assert min(drawn[:9]) > 0.1
    assert max(drawn[9:]) == 0.0
    # Nothing of a robot's body is cut off at the sides.
    assert all((np.abs(t[TILE_PX // 3 :, [0, -1]].astype(int) - PAPER) < 20).all() for t in tiles)


def test_the_command_writes_the_sheet_of_the_robot_that_is_set(tmp_path):
    out = tmp_path / "new" / "robots.png"
    command = ["robot-sheet", "--count", "2", "--seed", "4", "--out", str(out)]
    shown = CliRunner().invoke(app, [*command, "--set", "render.draws.robot.as_built_share=1.0"])
    assert shown.exit_code == 0, shown.output
    again = robot_sheet("burger", RobotDraws(as_built_share=1.0), count=2, seed=4)
    assert np.array_equal(cv2.imread(str(out))[:, :, ::-1], again)
    assert not np.array_equal(again, robot_sheet("burger", RobotDraws(as_built_share=1.0), count=2, seed=5))
