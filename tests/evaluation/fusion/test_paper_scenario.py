from __future__ import annotations

import math
from dataclasses import replace

import pytest

from rendezvous.evaluation.fusion.paper_scenario import scenario
from rendezvous.geometry.se2 import SE2
from rendezvous.geometry.wall_agreement import wall_agreement
from tests.evaluation.toy_pairs import toy_pair


@pytest.fixture(scope="module")
def pair():
    return toy_pair(0)


def test_frames_and_sizes_are_those_of_the_paper_and_maps_and_robots_lie_as_before(pair):
    found = scenario(pair)
    assert found.T_m0_m1 == SE2(6.0, -5.8, math.pi)
    for grid in (found.grid_0, found.grid_1):
        assert grid.cells.shape == (384, 384)
        assert grid.resolution_m == 0.05
        assert grid.T_m_g.yaw_rad == 0.0
    assert found.overlap == pytest.approx(pair.overlap, abs=0.02)
    before, now = (wall_agreement(p.grid_0, p.grid_1, p.T_m0_m1).share for p in (pair, found))
    assert now == pytest.approx(before, abs=0.05)
    moved = found.T_m0_r1.as_array() - pair.T_m0_r1.as_array()
    assert moved[:2] == pytest.approx([0.0, 0.0], abs=1e-6)
    assert math.remainder(moved[2], 2.0 * math.pi) == pytest.approx(0.0, abs=1e-9)


def test_a_map_that_lies_straight_keeps_its_cells(pair):
    shifted = replace(pair.grid_0, T_m_g=pair.grid_0.T_m_g @ SE2(0.013, -0.021, 0.0))
    found = scenario(replace(pair, grid_0=shifted)).grid_0
    for now, before in ((found.occupied(), shifted.occupied()), (found.free(), shifted.free())):
        assert found.cell_centres(now) == pytest.approx(shifted.cell_centres(before), abs=1e-9)


def test_a_map_that_does_not_fit_is_none(pair):
    assert scenario(replace(pair, grid_0=replace(pair.grid_0, resolution_m=0.2))) is None
