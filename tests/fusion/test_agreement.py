from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from rendezvous.fusion.agreement import agreement, map_agreement
from rendezvous.fusion.merge import merged
from rendezvous.geometry.occupancy_grid import UNKNOWN
from rendezvous.geometry.se2 import SE2

from tests.baselines.windows import REAL_T_M0_M1, cuts, real_maps
from tests.fusion.grids import constant_grid, drawn_grid, grids, poses, shown


def test_without_tolerance_it_is_the_intersection_over_union_of_cells():
    grid_a, grid_b = drawn_grid(0), drawn_grid(1)
    a, b = grid_a.occupied(), grid_b.occupied()
    assert agreement(grid_a, grid_b, 0.0).iou == pytest.approx((a & b).sum() / (a | b).sum())


@pytest.mark.parametrize(
    ("text", "iou"),
    [("#....", 1.0), (".#...", 1.0), ("..#..", 0.0), ("##...", 1.0), ("#.#..", 0.5), ("#.###", 0.25)],
)
def test_cells_within_one_cell_count_as_the_same(text, iou):
    # "##...": all three cells have a partner. "#.#..": one cell is in both maps, two are in all.
    assert agreement(shown("#...."), shown(text), 1.0).iou == pytest.approx(iou)


@given(grids, grids)
def test_it_is_the_same_from_either_side_and_grows_with_the_tolerance(grid_a, grid_b):
    there, back = agreement(grid_a, grid_b, 0.05), agreement(grid_b, grid_a, 0.05)
    assert (there.iou, there.share_a, there.share_b) == (back.iou, back.share_b, back.share_a)
    wider = agreement(grid_a, grid_b, 0.2)
    assert wider.near_a >= there.near_a
    assert wider.near_b >= there.near_b


def test_maps_without_walls_cannot_be_compared():
    nothing = shown("...")
    assert agreement(nothing, nothing, 1.0).iou is None
    with_wall = agreement(nothing, shown("..#"), 1.0)
    assert (with_wall.iou, with_wall.share_a, with_wall.share_b) == (0.0, None, 0.0)


def test_the_fused_map_of_a_worse_transform_agrees_less_with_the_true_one():
    grid_0, grid_1, T = cuts(0)
    true = merged(grid_0, grid_1, T)
    ious = [
        agreement(merged(grid_0, grid_1, SE2(off_m, 0.0, 0.0) @ T), true, 0.05).iou
        for off_m in (0.0, 0.05, 0.15, 0.4)
    ]
    assert ious[0] == 1.0
    assert ious == sorted(ious, reverse=True)
    assert ious[1] > 0.95 > 0.8 > ious[3]


def test_free_against_occupied_is_a_conflict_and_unknown_is_none():
    # Four cells are known in both, each counted both ways; two of them are contradictions.
    found = map_agreement(shown("##..??#"), shown("#.#.#.?"), SE2.identity(), tolerance_m=0.5)
    assert found.known_in_both == 2 * 4
    assert found.conflict_share == pytest.approx(2 / 4)
    assert (found.compared, found.wall_share) == (4, 0.5)


def test_conflicts_are_counted_in_the_cells_of_both_maps():
    coarse, fine = shown("#.", resolution_m=2.0), shown("...# ...#")
    for pair in ((coarse, fine), (fine, coarse)):
        found = map_agreement(*pair, SE2.identity(), tolerance_m=0.5)
        # Both coarse cells contradict the fine map, and of the eight fine ones all but two.
        assert found.known_in_both == 2 + 8
        assert found.conflict_share == pytest.approx((2 + 6) / 10)


@given(grids, grids, poses)
def test_two_maps_agree_alike_from_either_of_them(grid_0, grid_1, T_m0_m1):
    there = map_agreement(grid_0, grid_1, T_m0_m1)
    back = map_agreement(grid_1, grid_0, T_m0_m1.inverse())
    # A cell on another's edge, within rounding, may fall on either side.
    assert abs(there.known_in_both - back.known_in_both) <= 2
    assert abs(there.compared - back.compared) <= 2


def test_maps_that_share_nothing_known_have_no_agreement():
    grid = drawn_grid(0)
    found = map_agreement(grid, constant_grid(UNKNOWN, like=grid), SE2.identity())
    assert (found.wall_share, found.conflict_share, found.compared, found.known_in_both) == (None, None, 0, 0)


def test_a_map_agrees_wholly_with_itself_and_less_with_itself_moved():
    grid, _, _ = cuts(0)
    itself, moved = map_agreement(grid, grid, SE2.identity()), map_agreement(grid, grid, SE2(0.5, 0.3, 0.0))
    assert (itself.wall_share, itself.conflict_share) == (1.0, 0.0)
    assert itself.known_in_both == 2 * np.count_nonzero(grid.known())
    assert moved.wall_share < 0.5
    assert moved.conflict_share > 0.03


def test_real_maps_agree_best_where_they_are_registered(real_data):
    grid_0, grid_1, T_m0_c = real_maps(real_data)
    right = map_agreement(grid_0, grid_1, REAL_T_M0_M1)
    wrong = map_agreement(grid_0, grid_1, T_m0_c @ SE2(0.3, 0.0, 0.1) @ T_m0_c.inverse() @ REAL_T_M0_M1)
    assert right.wall_share > 0.6 > 0.45 > wrong.wall_share
    assert right.conflict_share < wrong.conflict_share
