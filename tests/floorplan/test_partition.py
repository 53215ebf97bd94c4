from __future__ import annotations

import numpy as np
import pytest
import shapely
from shapely import box

from rendezvous.floorplan.partition import footprint, is_compact, merged, shared_walls, subdivided

SHELL = box(0.0, 0.0, 12.0, 9.0)


def rooms_of(seed: int, slant: float) -> list[shapely.Polygon]:
    rng = np.random.default_rng(seed)
    return subdivided([SHELL], rng, room_area_m2=14.0, min_side_m=2.0, slant=slant)


@pytest.mark.parametrize("slant", [0.0, 0.5])
@pytest.mark.parametrize("seed", range(10))
def test_rooms_tile_the_cell_and_none_is_narrow(seed: int, slant: float):
    rooms = rooms_of(seed, slant)
    assert len(rooms) > 2
    assert shapely.union_all(rooms).area == pytest.approx(SHELL.area)
    assert sum(room.area for room in rooms) == pytest.approx(SHELL.area)
    assert all(not room.buffer(-0.97).is_empty for room in rooms)


@pytest.mark.parametrize("seed", range(10))
def test_joined_rooms_still_tile_the_cell(seed: int):
    rooms = rooms_of(seed, 0.3)
    joined = merged(rooms, np.random.default_rng(seed), share=0.6, max_area_m2=35.0)
    assert len(joined) < len(rooms)
    assert sum(room.area for room in joined) == pytest.approx(SHELL.area, rel=1e-6)
    assert all(is_compact(room) for room in joined)


def test_neighbours_share_the_stretch_they_have_in_common():
    cells = [box(0, 0, 4, 3), box(4, 1, 7, 5), box(0, 3, 4, 5), box(8, 0, 9, 1)]
    walls = shared_walls(cells)
    assert set(walls) == {(0, 1), (0, 2), (1, 2)}
    assert sorted(map(tuple, walls[0, 1].tolist())) == [(4.0, 1.0), (4.0, 3.0)]
    assert sorted(map(tuple, walls[0, 2].tolist())) == [(0.0, 3.0), (4.0, 3.0)]
    assert sorted(map(tuple, walls[1, 2].tolist())) == [(4.0, 3.0), (4.0, 5.0)]


def test_slanted_neighbours_share_their_wall():
    cells = rooms_of(0, 1.0)
    walls = shared_walls(cells)
    lengths_m = {
        (i, j): cells[i].intersection(cells[j].buffer(1e-9)).length / 2.0
        for j in range(len(cells))
        for i in range(j)
    }
    long_m = {pair: length_m for pair, length_m in lengths_m.items() if length_m > 0.1}
    assert len(long_m) >= 5
    found_m = {pair: np.linalg.norm(walls[pair][1] - walls[pair][0]) for pair in long_m}
    assert found_m == pytest.approx(long_m, abs=1e-3)


def test_cells_that_touch_in_a_corner_share_no_wall():
    assert shared_walls([box(0, 0, 1, 1), box(1, 1, 2, 2)]) == {}


@pytest.mark.parametrize("slanted", [False, True])
def test_footprints_are_simple_and_of_the_size_asked_for(slanted: bool):
    rng = np.random.default_rng(0)
    for _ in range(60):
        shell = footprint(rng, width_m=12.0, depth_m=9.0, slanted=slanted)
        assert shell.is_valid
        assert not shell.interiors
        assert SHELL.buffer(1e-9).covers(shell)
        assert shell.area > 0.5 * SHELL.area
