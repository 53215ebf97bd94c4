"""Defects as drawn when the shipped weights were trained: counts of unknown, free and occupied cells."""

from __future__ import annotations

import pytest

from rendezvous.geometry.occupancy_grid import FREE, OCCUPIED, UNKNOWN, OccupancyGrid
from rendezvous.geometry.se2 import SE2
from rendezvous.training.frame_error import defects
from rendezvous.training.frame_error.augmentation import Augmentation, augmented
from rendezvous.training.frame_error.pairs import MapPair
from tests.training.frame_error.test_augmentation import rng, room


def counts(grid: OccupancyGrid) -> list[int]:
    return [int((grid.cells == value).sum()) for value in (UNKNOWN, FREE, OCCUPIED)]


def about(expected: list[int]):
    """The same but for some cells on whose edge a centre falls."""
    return pytest.approx(expected, rel=1e-3, abs=3)


def bent(grid: OccupancyGrid, generator):
    return defects.bent(grid, SE2(1.0, 2.0, 0.3), amplitude_m=0.1, resolution_m=0.03, rng=generator)


@pytest.mark.parametrize(
    ("defect", "expected"),
    [
        (bent, [[9461, 12557, 797], [9483, 12578, 754], [9458, 12578, 779]]),
        (defects.thickened, [[3059, 4389, 552], [3059, 4389, 552], [2920, 4256, 824]]),
        (defects.ragged, [[3248, 4561, 191], [3216, 4546, 238], [3217, 4541, 242]]),
        (defects.patched, [[4282, 3487, 231], [4458, 3345, 197], [3304, 4453, 243]]),
        (defects.specked, [[3285, 4436, 279], [3269, 4455, 276], [3235, 4488, 277]]),
        (defects.rescanned, [[21382, 7122, 296], [21511, 7012, 277], [22342, 6184, 274]]),
        (defects.with_spurious_rays, [[20236, 8341, 223], [22877, 5655, 268], [20903, 7660, 237]]),
    ],
)
def test_a_defect_is_drawn_as_it_was(defect, expected: list[list[int]]):
    for seed, cells in enumerate(expected):
        assert counts(defect(room(), rng(seed))) == about(cells)


@pytest.mark.parametrize(
    ("seed", "expected_0", "expected_1"),
    [
        (0, [56687, 5923, 291], [3525, 4286, 370]),
        (1, [24642, 4269, 230], [24214, 4655, 272]),
        (2, [3585, 4041, 374], [3850, 4002, 329]),
        (3, [21856, 6975, 310], [55902, 6237, 261]),
    ],
)
def test_a_pair_gets_the_defects_that_it_got(seed: int, expected_0: list[int], expected_1: list[int]):
    pair = MapPair(
        pair_id="",
        grid_0=room(),
        grid_1=room(),
        T_m0_m1=SE2(1.0, -0.5, 0.4),
        T_m1_r1=SE2(1.0, 1.5, 0.0),
        T_m0_r0=SE2(0.5, 1.2, 0.0),
        overlap=0.5,
    )
    changed = augmented(pair, Augmentation(untouched=0.0), rng(seed))
    assert counts(changed.grid_0) == about(expected_0)
    assert counts(changed.grid_1) == about(expected_1)
