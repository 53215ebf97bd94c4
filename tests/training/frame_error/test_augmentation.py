"""Defects that make maps look real, and what they must leave alone."""

from __future__ import annotations

from itertools import compress

import cv2
import numpy as np
import pytest

from rendezvous.config.load import load_config
from rendezvous.errors import ConfigError
from rendezvous.geometry.occupancy_grid import FREE, OCCUPIED, UNKNOWN, OccupancyGrid
from rendezvous.geometry.se2 import SE2
from rendezvous.training.frame_error.augmentation import (
    Augmentation,
    augmented,
    draw_obstacles,
    with_obstacles,
)
from rendezvous.training.frame_error.defects import (
    bent,
    beyond_line_unknown,
    ragged,
    rescanned,
    specked,
    thickened,
    with_spurious_rays,
)
from rendezvous.training.frame_error.pairs import MapPair, PairTable
from tests.conftest import ROOT

SHARES = (
    "furniture",
    "cut",
    "bend",
    "resolution",
    "rescan",
    "spurious",
    "thick",
    "ragged",
    "patches",
    "specks",
)
NOTHING = dict.fromkeys(("untouched", *SHARES), 0.0)


def rng(seed: int = 0) -> np.random.Generator:
    return np.random.default_rng(seed)


def room() -> OccupancyGrid:
    """A room of 4 m by 3 m with a wall of one cell around it, unknown outside."""
    cells = np.full((80, 100), UNKNOWN, np.uint8)
    cells[10:70, 10:90] = OCCUPIED
    cells[11:69, 11:89] = FREE
    return OccupancyGrid(cells=cells, resolution_m=0.05, T_m_g=SE2(-1.0, 0.5, 0.3))


def distance_to_walls_m(grid: OccupancyGrid, p_m: np.ndarray) -> np.ndarray:
    """(N,) [m] from points (N, 2) [m] in m to the nearest occupied cell's centre, as the grid's cells
    measure it."""
    gap = cv2.distanceTransform((~grid.occupied()).astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    row, col = grid.cell_of(p_m).T
    return grid.resolution_m * gap[row.clip(0, gap.shape[0] - 1), col.clip(0, gap.shape[1] - 1)]


def test_without_shares_nothing_happens(pairs: PairTable):
    pair, settings = pairs[0], Augmentation(**NOTHING)
    changed = augmented(pair, settings, rng())
    assert (changed.grid_0.cells == pair.grid_0.cells).all()
    assert (changed.grid_1.cells == pair.grid_1.cells).all()
    assert augmented(pair, Augmentation(untouched=1.0), rng()) is pair


@pytest.mark.parametrize("defect", SHARES)
def test_each_share_brings_its_defect(pairs: PairTable, defect: str):
    pair, settings = pairs[0], Augmentation(**(NOTHING | {defect: 1.0}))
    changed = [augmented(pair, settings, rng(seed)) for seed in range(5)]
    for before, afters in (
        (pair.grid_0, [made.grid_0 for made in changed]),
        (pair.grid_1, [made.grid_1 for made in changed]),
    ):
        assert any(not np.array_equal(before.cells, after.cells) for after in afters)


def test_equal_streams_give_equal_maps_and_leave_the_pair_alone(pairs: PairTable):
    pair, settings = pairs[0], Augmentation(untouched=0.0)
    before = pair.grid_0.cells.copy(), pair.grid_1.cells.copy()
    once, again = (augmented(pair, settings, rng(3)) for _ in range(2))
    assert (once.grid_0.cells == again.grid_0.cells).all()
    assert (once.grid_1.cells == again.grid_1.cells).all()
    assert (pair.grid_0.cells == before[0]).all()
    assert (pair.grid_1.cells == before[1]).all()


@pytest.mark.parametrize("seed", range(20))
def test_the_label_stays_walls_that_remain_are_where_they_were(pairs: PairTable, seed: int):
    pair = pairs[seed % len(pairs)]
    # Without what adds occupied cells of its own.
    shares = {"cut", "bend", "resolution", "rescan", "thick", "ragged", "patches"}
    settings = Augmentation(**(NOTHING | dict.fromkeys(shares, 1.0)))
    changed = augmented(pair, settings, rng(seed))
    for before, after in ((pair.grid_0, changed.grid_0), (pair.grid_1, changed.grid_1)):
        walls_m = after.cell_centres(after.occupied())
        if len(walls_m) < 50:
            continue
        # A cell of up to 0.1 m, thickened and grown, bent by 3 cm; beams through walls end at dots beyond.
        gaps_m = distance_to_walls_m(before, walls_m)
        assert np.median(gaps_m) <= 0.101
        assert np.quantile(gaps_m, 0.75) < 0.16


def test_a_map_bent_by_nothing_in_cells_of_the_same_size_only_has_other_cells():
    grid = room()
    same = bent(grid, SE2.identity(), amplitude_m=0.0, resolution_m=0.05, rng=rng())
    assert (grid.sample(same.cell_centres(same.free())) == FREE).all()
    # Walls of one cell fall into two at most.
    assert grid.occupied().sum() <= same.occupied().sum() <= 2 * grid.occupied().sum()


@pytest.mark.parametrize("resolution_m", [0.03, 0.05, 0.1])
def test_a_bent_map_moves_no_wall_by_more_than_the_amplitude(resolution_m: float):
    wavy = bent(room(), SE2.identity(), amplitude_m=0.03, resolution_m=resolution_m, rng=rng(2))
    gaps_m = distance_to_walls_m(room(), wavy.cell_centres(wavy.occupied()))
    assert gaps_m.max() <= 0.085 + resolution_m
    # No wall is lost: all of the old lie near the new.
    gaps_m = distance_to_walls_m(wavy, room().cell_centres(room().occupied()))
    assert gaps_m.max() <= 0.085 + resolution_m


def test_a_bent_map_stays_as_it_is_where_its_label_is_exact():
    cells = np.full((200, 200), FREE, np.uint8)
    cells[:, 60], cells[140, :] = OCCUPIED, OCCUPIED
    grid = OccupancyGrid(cells=cells, resolution_m=0.05, T_m_g=SE2(-2.0, 1.0, 0.4))
    T_m_fixed = grid.T_m_g @ SE2(60.5 * 0.05, 140.5 * 0.05, 1.0)
    near_m, moved_m = [], []
    for seed in range(20):
        wavy = bent(grid, T_m_fixed, amplitude_m=0.1, resolution_m=0.02, rng=rng(seed))
        walls_m = wavy.cell_centres(wavy.occupied())
        off_m = distance_to_walls_m(grid, walls_m)
        near = np.hypot(*(walls_m - (T_m_fixed.x_m, T_m_fixed.y_m)).T) < 0.15
        near_m.append(off_m[near].max())
        moved_m.append(off_m.max())
    assert max(near_m) <= 0.05 + 1e-6  # a cell, as distances go
    assert max(moved_m) > 0.1


def test_rescanning_shows_nothing_that_was_not_there_but_behind_walls():
    grid, found = room(), rescanned(room(), rng(1))
    p_m = found.cell_centres(found.known())
    there = grid.sample(p_m)
    new = found.cells[found.known()]
    inside = there == FREE
    assert (new[inside] == FREE).all()
    assert inside.sum() > 0.3 * grid.free().sum()
    assert (there == OCCUPIED).sum() > 50


def test_spurious_rays_free_what_lies_behind_walls_and_keep_the_rest():
    grid, found = room(), with_spurious_rays(room(), rng(4))
    kept = found.sample(grid.cell_centres(grid.known()))
    assert (kept[grid.cells[grid.known()] == FREE] == FREE).all()
    beyond = grid.sample(found.cell_centres(found.free())) == UNKNOWN
    assert beyond.sum() > 20


def test_thickened_walls_hold_the_old_ones():
    thick = thickened(room(), rng())
    assert thick.occupied()[room().occupied()].all()
    assert 1.5 < thick.occupied().sum() / room().occupied().sum() < 3.5


def test_ragged_walls_lose_cells_and_grow_only_beside_themselves():
    worn = ragged(room(), rng(1))
    assert 0.3 < worn.occupied()[room().occupied()].mean() < 1.0
    near = cv2.dilate(room().occupied().astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
    assert not (worn.occupied() & ~near).any()


def test_specks_change_few_cells_and_only_free_ones():
    changed = specked(room(), rng(1)).cells != room().cells
    assert 0 < changed.sum() <= 0.032 * room().free().sum()
    assert room().free()[changed].all()


def test_nothing_remains_ahead_of_a_line():
    line = SE2(1.0, 1.5, 0.7)
    cut = beyond_line_unknown(room(), line)
    behind = (line.inverse() @ room().cell_centres(room().known()))[:, 0] < 0.0
    assert (cut.known()[room().known()] == behind).all()


@pytest.mark.parametrize("seed", range(12))
def test_cuts_leave_a_strip_of_the_asked_width_around_the_meeting_point(seed: int):
    cells = np.full((260, 260), FREE, np.uint8)
    T_m0_m1 = SE2(1.0, -2.0, 0.7)
    grids = [
        OccupancyGrid(cells=cells, resolution_m=0.1, T_m_g=T_m @ SE2(-13.0, -13.0, 0.0))
        for T_m in (SE2.identity(), T_m0_m1.inverse())
    ]
    pair = MapPair(
        pair_id="",
        grid_0=grids[0],
        grid_1=grids[1],
        T_m0_m1=T_m0_m1,
        T_m1_r1=T_m0_m1.inverse() @ SE2(0.5, 0.3, 0.0),
        overlap=1.0,
    )
    least_m, most_m = (1.0, 2.0)
    cut = augmented(
        pair, Augmentation(**(NOTHING | {"cut": 1.0, "cut_overlap_m": (least_m, most_m)})), rng(seed)
    )
    p_m0 = cut.grid_0.cell_centres(cut.grid_0.known())
    both_m0 = p_m0[cut.grid_1.sample(T_m0_m1.inverse() @ p_m0) == FREE]
    across = np.radians(np.arange(0.0, 180.0, 0.25))
    width_m = np.ptp(both_m0 @ np.stack([np.cos(across), np.sin(across)]), axis=0).min()
    assert least_m - 0.2 < width_m < most_m + 0.2
    assert np.hypot(*(both_m0 - (0.5, 0.3)).T).min() < 0.15
    for grid in (cut.grid_0, cut.grid_1):
        assert 0.3 < grid.known().mean() < 0.7


def test_things_stand_at_one_place_in_both_maps(pairs: PairTable):
    pair = pairs[0]
    obstacles = draw_obstacles(pair, count=12, rng=rng(5))
    in_both = tuple(compress(obstacles.obstacles, obstacles.shown.all(axis=1)))
    assert 0 < len(in_both) <= 12
    seen_m, T_m0_r0 = np.array([pair.T_m0_r1.x_m, pair.T_m0_r1.y_m]), pair.T_m0_r0
    assert T_m0_r0 is not None
    line_m = np.linspace((T_m0_r0.x_m, T_m0_r0.y_m), seen_m, 50)
    outlines_m = np.vstack([outline for obstacle in obstacles.obstacles for outline in obstacle.outlines_m])
    assert np.hypot(*np.moveaxis(outlines_m[:, None] - line_m, -1, 0)).min() > 0.15
    grids = (
        with_obstacles(pair.grid_0, in_both, SE2.identity()),
        with_obstacles(pair.grid_1, in_both, pair.T_m0_m1.inverse()),
    )
    outlines_m0 = np.vstack([outline for obstacle in in_both for outline in obstacle.outlines_m])
    found = 0
    for grid, before, T_m_m0 in zip(
        grids, (pair.grid_0, pair.grid_1), (SE2.identity(), pair.T_m0_m1.inverse()), strict=True
    ):
        p_m = T_m_m0 @ outlines_m0
        known = before.sample(p_m) == FREE
        assert distance_to_walls_m(grid, p_m[known]).max(initial=0.0) <= 0.08
        found += int(known.sum())
    assert found > 10


def test_the_configuration_takes_shares_and_says_which_are_wrong():
    config = load_config(
        ROOT / "stages.yaml", overrides=["train.sampling.augmentation.resolution_m=[0.04, 0.06]"]
    )
    assert config.train.sampling.augmentation.resolution_m == (0.04, 0.06)
    with pytest.raises(ConfigError, match=r"rescan is 1.5; must be from 0 to 1"):
        Augmentation(rescan=1.5)
    for resolution_m in ((0.0, 0.0), (0.1, 0.03)):
        with pytest.raises(
            ConfigError, match=r"resolution_m is \[0.*must rise from at least 0.01 to at most 1"
        ):
            Augmentation(resolution_m=resolution_m)
    with pytest.raises(ConfigError, match=r"cut_overlap_m is \[-1.0, 2.0\]; must rise from at least 0 to"):
        Augmentation(cut_overlap_m=(-1.0, 2.0))
