"""The evidence of alignments, against maps whose walls and floor are counted by hand."""

from __future__ import annotations

import math

import numpy as np
import pytest

from rendezvous.alignment.evidence import WindowEvidence, coarse_evidence
from rendezvous.alignment.window import (
    FREE_CELL,
    OCCUPIED_CELL,
    UNKNOWN_CELL,
    MapWindow,
    RobotSight,
    seen_from,
)
from rendezvous.geometry.se2 import SE2

CELL_M = 0.05
IN_PLACE = SE2.identity()
WALL_M = 40 * CELL_M  # of map 0, which knows floor to both sides of it


def _window(theta: SE2 = IN_PLACE, *, sight: bool = False) -> MapWindow:
    """A wall along x with floor 1 m to both sides, and the same map placed wrongly by θ."""
    cells = np.zeros((2, 120, 120), np.uint8)
    rows, cols = np.mgrid[:120, :120]
    for channel, T in ((cells[0], SE2.identity()), (cells[1], theta.inverse())):
        x, y = np.moveaxis(T @ np.stack([(cols - 59.5) * CELL_M, (rows - 59.5) * CELL_M], -1), -1, 0)
        inside = np.abs(x) < 0.5 * WALL_M
        channel[inside & (np.abs(y - 0.025) < 1.0)] = FREE_CELL
        channel[inside & (np.abs(y - 0.025) < 0.5 * CELL_M)] = OCCUPIED_CELL
    if not sight:
        return MapWindow(cells=cells, cell_m=CELL_M)
    robots = [(0.5, 0.5), (-0.5, 0.5)]
    seen = [
        seen_from(one == OCCUPIED_CELL, robot, cell_m=CELL_M, robot=RobotSight())
        for one, robot in zip(cells, robots, strict=True)
    ]
    return MapWindow(cells=cells, cell_m=CELL_M, sight=np.stack(seen))


def _counted(window: MapWindow, theta: SE2) -> np.ndarray:
    (evidence,) = WindowEvidence.of(window).of_alignments([theta])
    return np.array([*(np.exp(evidence[:3]) - [0.5, 0.5, 1.0]), evidence[3]])


@pytest.mark.parametrize("theta", [SE2.identity(), SE2(0.3, -0.2, 0.0), SE2(0.2, 0.1, math.pi / 2)])
def test_a_true_alignment_lays_walls_on_walls_and_floor_on_floor(theta):
    walls, contradictions, floor_m2, hidden = _counted(_window(theta), theta)
    assert walls == pytest.approx(2 * WALL_M, abs=0.15)
    assert contradictions == pytest.approx(0.0, abs=0.06)
    assert floor_m2 == pytest.approx(2.0 * WALL_M, rel=0.1)
    assert hidden == 0.0


def test_a_shift_across_the_walls_lays_them_on_floor():
    walls, contradictions, floor_m2, _ = _counted(_window(), SE2(0.0, 0.5, 0.0))
    assert walls == pytest.approx(0.0, abs=1e-9)
    assert contradictions == pytest.approx(2 * WALL_M, abs=0.15)
    assert floor_m2 == pytest.approx(1.5 * WALL_M, rel=0.25)


def test_a_wall_beside_a_wall_is_neither_the_same_nor_a_contradiction():
    walls, contradictions, _, _ = _counted(_window(), SE2(0.0, 0.15, 0.0))
    assert walls == pytest.approx(0.0, abs=1e-9)
    assert contradictions == pytest.approx(0.0, abs=1e-9)
    walls, _, _, _ = _counted(_window(), SE2(0.0, 0.1, 0.0))
    assert walls == pytest.approx(2 * WALL_M, abs=0.15)


def test_walls_on_the_unknown_count_nowhere():
    walls, contradictions, floor_m2, _ = _counted(_window(), SE2(0.0, 2.5, 0.0))
    assert (walls, contradictions, floor_m2) == pytest.approx((0.0, 0.0, 0.0), abs=1e-9)


def test_robots_that_a_wall_hides_from_each_other_are_told():
    window = _window(sight=True)
    assert _counted(window, SE2.identity())[3] == 0.0
    assert _counted(window, SE2(0.0, -1.0, 0.0))[3] == pytest.approx(1.0, abs=0.1)
    without = WindowEvidence.of(window, uses_sight=False).of_alignments([SE2(0.0, -1.0, 0.0)])
    assert without[0, 3] == 0.0


def test_maps_without_walls_have_no_evidence_of_walls():
    cells = np.full((2, 120, 120), FREE_CELL, np.uint8)
    cells[1] = UNKNOWN_CELL
    assert _counted(MapWindow(cells=cells, cell_m=CELL_M), SE2.identity()) == pytest.approx([0, 0, 0, 0])


def test_blocks_keep_the_length_of_walls():
    window = _window()
    pooled = WindowEvidence.of(window).pooled(4)
    assert pooled.shape == (2, 3, 30, 30)
    assert pooled[0, 0].sum() == pytest.approx(WALL_M, rel=1e-5)
    assert pooled[0, 2].sum() * 0.2**2 == pytest.approx(WALL_M * 1.5, rel=0.1)
    np.testing.assert_allclose(coarse_evidence(np.array([0.5]), np.array([-0.1])), [[0.0, math.log(0.5)]])
