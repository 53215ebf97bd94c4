from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from rendezvous.geometry.occupancy_grid import FREE, OCCUPIED, UNKNOWN, OccupancyGrid, grid_from_png
from rendezvous.geometry.se2 import SE2
from rendezvous.geometry.wall_agreement import count_near, wall_agreement
from tests.synthetic import RESOLUTION_M, synthetic_row


def _grids(row):
    return [
        grid_from_png(row[f"map_{i}"], resolution_m=row["resolution_m"], T_m_g=row[f"origin_{i}"])
        for i in "01"
    ]


@cache
def _row(seed: int):
    return synthetic_row(np.random.default_rng(seed), plan=seed)


@pytest.fixture(scope="module", params=range(4))
def row(request):
    return _row(request.param)


def test_rightly_aligned_maps_pass_the_check(row):
    agreement = wall_agreement(*_grids(row), row["T_m0_m1_local"])
    assert agreement.compared > 100
    assert agreement.share >= 0.95


@pytest.mark.parametrize("shift", [SE2(0.3, 0, 0), SE2(0, 0.3, 0), SE2(0, 0, 0.0524), SE2(0, 0, -0.0524)])
def test_maps_off_by_30_cm_or_3_degrees_fail_the_check(shift):
    # The hardest turn is the one about the meeting point, where the maps overlap.
    shares = []
    for seed in range(6):
        row = _row(seed)
        C = SE2(row["T_m0_r0"].x_m, row["T_m0_r0"].y_m, 0.0)
        wrong = C @ shift @ C.inverse() @ row["T_m0_m1_local"]
        shares.append(wall_agreement(*_grids(row), wrong).share)
    assert np.median(shares) < 0.95


def test_agreement_is_the_same_from_either_map(row):
    grids = _grids(row)
    there = wall_agreement(grids[0], grids[1], row["T_m0_m1"])
    assert wall_agreement(grids[1], grids[0], row["T_m0_m1"].inverse()) == there


def _wall(col: int) -> OccupancyGrid:
    cells = np.full((10, 40), FREE, np.uint8)
    cells[:, col] = OCCUPIED
    return OccupancyGrid(cells=cells, resolution_m=RESOLUTION_M, T_m_g=SE2.identity())


@pytest.mark.parametrize(("cells_apart", "share"), [(0, 1.0), (1, 1.0), (2, 1.0), (3, 0.0)])
def test_walls_agree_up_to_ten_centimetres(cells_apart, share):
    agreement = wall_agreement(_wall(20), _wall(20 + cells_apart), SE2.identity())
    assert agreement.compared == 20
    assert agreement.share == share


def test_walls_outside_the_other_map_are_not_compared():
    unknown = OccupancyGrid(
        cells=np.full((10, 40), UNKNOWN, np.uint8), resolution_m=RESOLUTION_M, T_m_g=SE2.identity()
    )
    agreement = wall_agreement(_wall(20), unknown, SE2.identity())
    assert (agreement.compared, agreement.share) == (0, None)


def test_the_tolerance_belongs_to_what_agrees():
    here = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0]])
    there = np.array([[0.1, 0.0], [1.0, 0.1 + 1e-6]])
    assert count_near(here, there, 0.1) == 1
    # Cells two apart, whose centres differ by 0.1 but for rounding.
    cols = 0.05 * (np.arange(200) + 0.5)
    for a, b in zip(cols[:-2], cols[2:], strict=True):
        assert count_near(np.array([[a, 0.0]]), np.array([[b, 0.0]]), 0.1) == 1
    assert count_near(here, np.zeros((0, 2)), 0.1) == count_near(np.zeros((0, 2)), there, 0.1) == 0
