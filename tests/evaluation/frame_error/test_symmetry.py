from __future__ import annotations

import json
import math
from itertools import product

import numpy as np
import pytest
from pytest import approx

from rendezvous.evaluation.frame_error.symmetry import SYMMETRIC_SHARE, Symmetry, turn_symmetry
from rendezvous.geometry.occupancy_grid import FREE, OCCUPIED, Mask, OccupancyGrid
from rendezvous.geometry.se2 import SE2
from tests.evaluation.toy_pairs import outcomes_of

RESOLUTION_M = 0.05


def _grid(walls: Mask) -> OccupancyGrid:
    cells = np.where(walls, OCCUPIED, FREE).astype(np.uint8)
    return OccupancyGrid(cells=cells, resolution_m=RESOLUTION_M, T_m_g=SE2.identity())


def _room(height: int, width: int) -> Mask:
    """The four walls of a room, in cells."""
    walls = np.zeros((height, width), dtype=bool)
    walls[[0, -1]] = walls[:, [0, -1]] = True
    return walls


@pytest.mark.parametrize(("height", "width"), [(60, 60), (61, 61), (40, 120)])
def test_a_room_looks_the_same_turned_wherever_it_is_in_its_map(height: int, width: int):
    assert turn_symmetry(_grid(_room(height, width))) == 1.0
    aside = np.pad(_room(height, width), ((3, 20), (0, 11)))
    assert turn_symmetry(_grid(aside)) == 1.0


@pytest.mark.parametrize("tolerance_m", [0.0, 0.05, 0.10])
def test_shares_are_those_of_counting_at_every_shift(tolerance_m: float):
    walls = np.random.default_rng(1).random((7, 9)) < 0.25
    best = 0
    for turns in (1, 2, 3):
        turned = np.argwhere(np.rot90(walls, turns))
        for shift in product(range(-12, 13), repeat=2):
            gaps = np.linalg.norm((turned + shift)[:, None] - np.argwhere(walls), axis=2).min(axis=1)
            best = max(best, int((gaps * RESOLUTION_M <= tolerance_m + 1e-9).sum()))
    found = turn_symmetry(_grid(walls), tolerance_m=tolerance_m)
    assert found == approx(best / walls.sum())
    assert turn_symmetry(_grid(walls | np.rot90(walls, 2))) == 1.0
    assert turn_symmetry(_grid(np.zeros((5, 5), dtype=bool))) == 0.0


def test_symmetric_scenes_are_counted_apart():
    found = outcomes_of(np.array([[1.0, 0.0, math.pi], [0.1, 0.0, 0.0], [0.3, 0.0, 0.0]]))
    apart = Symmetry.of(np.array([SYMMETRIC_SHARE, 0.2, 0.59]), found, np.ones((5, 3)))
    assert apart.methods["toy"].symmetric.position_m.value == 1.0
    assert apart.methods["toy"].others.position_m.value == approx(0.2)
    assert json.loads(json.dumps(apart.to_json(), allow_nan=False))["symmetric_pairs"] == 1
    assert Symmetry.of(np.zeros(3), found, np.ones((5, 3))).methods["toy"].symmetric is None
