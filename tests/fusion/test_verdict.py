"""Doubts about a fused map, each by itself and at its limit."""

import math

import numpy as np
import pytest
from hypothesis import given

from rendezvous.alignment.estimate import WRONG_M, WRONG_RAD, Estimate
from rendezvous.alignment.window import DEFAULT_SEARCH
from rendezvous.fusion.fusion_input import FusionInput, SightedMode, SightedPose, SlamSpread
from rendezvous.fusion.merge import merged
from rendezvous.fusion.refinement import RefinedAlignment, frame_error_prior
from rendezvous.fusion.verdict import (
    MOST_CONFLICTS,
    MapAgreement,
    agreement,
    alignment_doubts,
    map_agreement,
    pose_doubts,
    refinement_doubts,
    sighting_doubts,
)
from rendezvous.geometry.occupancy_grid import FREE, UNKNOWN, OccupancyGrid
from rendezvous.geometry.se2 import SE2, Array
from rendezvous.training.frame_error.defects import bent
from tests.baselines.windows import REAL_T_M0_M1, cuts, real_maps
from tests.fusion.grids import constant_grid, drawn_grid, grids, poses, shown

SIGMA = np.diag([0.1, 0.1, math.radians(3.0)]) ** 2


def agreeing(
    *, wall_share: float | None = 0.95, conflict_share: float | None = 0.02, compared_m: float = 20.0
) -> MapAgreement:
    return MapAgreement(wall_share=wall_share, conflict_share=conflict_share, compared_m=compared_m)


def known_to(position_m: float, heading_rad: float) -> Array:
    return np.diag(np.square([position_m, 0.5 * position_m, heading_rad]))


def refined_to(theta: SE2, covariance: Array | None = None) -> RefinedAlignment:
    return RefinedAlignment(
        estimate=Estimate(theta=theta, covariance=covariance), search=DEFAULT_SEARCH, at_edge=False
    )


@pytest.mark.parametrize(
    ("agreement", "said"),
    [
        (agreeing(), None),
        (agreeing(wall_share=0.51, conflict_share=0.29, compared_m=3.0), None),
        (agreeing(wall_share=0.49), "only 49% of the walls that both maps show coincide"),
        (agreeing(conflict_share=0.31), "31% of the walls lie on the other map's floor"),
        (agreeing(compared_m=2.9), "share too little to check the alignment: 2.9 m of walls"),
        (agreeing(wall_share=None, conflict_share=None, compared_m=0.0), "too little to check"),
    ],
)
def test_maps_that_do_not_agree_are_doubted(agreement: MapAgreement, said: str | None):
    doubts = alignment_doubts(known_to(0.02, 0.01), agreement)
    assert len(doubts) == (said is not None)
    assert said is None or said in doubts[0]


@pytest.mark.parametrize(
    ("position_m", "heading_rad", "doubted"),
    [
        (0.49 * WRONG_M, 0.49 * WRONG_RAD, False),
        (0.51 * WRONG_M, 0.0, True),
        (0.0, 0.51 * WRONG_RAD, True),
    ],
)
def test_two_standard_deviations_must_not_reach_a_wrong_alignment(position_m, heading_rad, doubted):
    assert bool(alignment_doubts(known_to(position_m, heading_rad), agreeing())) is doubted


def test_an_unknown_spread_is_no_doubt_by_itself():
    assert alignment_doubts(None, agreeing()) == []


def test_an_estimate_contradicts_a_sighting_only_beyond_what_both_allow():
    prior = frame_error_prior(SightedPose.given(SE2(1.5, 0.0, 2.0), SIGMA), SE2.identity(), slam=SlamSpread())
    both = agreeing(), agreeing()
    (doubt,) = refinement_doubts(refined_to(SE2(0.6, 0.0, 0.0)), prior, both)
    assert "put robot 1 0.60 m and 0.0° from where it was seen" in doubt
    assert refinement_doubts(refined_to(SE2(0.3, 0.0, 0.0)), prior, both) == []
    assert refinement_doubts(refined_to(SE2(0.6, 0.0, 0.0), 9.0 * SIGMA), prior, both) == []
    assert refinement_doubts(refined_to(SE2(0.6, 0.0, 0.0)), None, both) == []


def test_only_agreement_that_clearly_falls_is_a_doubt():
    found, before = refined_to(SE2.identity()), agreeing(wall_share=0.90)
    assert refinement_doubts(found, None, (before, agreeing(wall_share=0.86))) == []
    (doubt,) = refinement_doubts(found, None, (before, agreeing(wall_share=0.84)))
    assert doubt == "84% of the shared walls coincide after the refinement, 90% did before it"


@pytest.mark.parametrize(("away_m", "doubted"), [(1.4, False), (1.6, True)])
@pytest.mark.parametrize("along", [(1.0, 0.0), (0.0, -1.0), (-1.0, 0.0), (0.0, 1.0)])
def test_a_robot_must_stand_close_to_cells_that_its_map_knows(away_m: float, doubted: bool, along):
    """One known cell in an unknown map, the robot in map 1 at a distance from its centre; robot 0 on one."""
    cells = np.full((41, 41), UNKNOWN, np.uint8)
    cells[20, 20] = FREE
    grid = OccupancyGrid(cells=cells, resolution_m=0.05, T_m_g=SE2(-20.5 * 0.05, -20.5 * 0.05, 0.0))
    T_m1_r1 = SE2(away_m * along[0], away_m * along[1], 0.4)
    doubts = pose_doubts(FusionInput(grid_0=grid, grid_1=grid, T_m0_r0=SE2.identity(), T_m1_r1=T_m1_r1))
    assert [doubt[:7] for doubt in doubts] == ["robot 1"] * doubted


def test_an_unlikely_detection_is_doubted():
    mode = SightedMode(T_r0_r1=SE2.identity(), covariance=SIGMA, mass=1.0, images=(0,))
    for score, doubted in ((0.49, True), (0.51, False), (None, False)):
        sighting = SightedPose(modes=(mode,), score=score, found_in=(0,))
        assert bool(sighting_doubts(sighting, refined=True)) is doubted


@pytest.mark.parametrize(
    ("mass", "refined", "doubted"), [(0.89, False, True), (0.91, False, False), (0.6, True, False)]
)
def test_of_several_readings_the_maps_choose_or_one_must_be_probable(mass, refined, doubted):
    modes = tuple(
        SightedMode(T_r0_r1=SE2(0.0, 0.0, yaw_rad), covariance=SIGMA, mass=share)
        for yaw_rad, share in ((0.0, mass), (math.pi, 1.0 - mass))
    )
    assert bool(sighting_doubts(SightedPose(modes=modes), refined=refined)) is doubted


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


def test_a_wall_on_floor_is_a_conflict_unless_a_wall_is_near():
    # Cells of 0.1 m. Map 0's walls lie on a wall, beside one, on floor, and on what map 1 does not know.
    map_0, map_1 = shown("##.#..#", resolution_m=0.1), shown("#.....?", resolution_m=0.1)
    found = map_agreement(map_0, map_1, SE2.identity())
    assert found.compared_m == pytest.approx(0.1 * (3 + 1))
    assert found.wall_share == pytest.approx(3 / 4)
    assert found.conflict_share == pytest.approx(1 / 4)


@pytest.mark.parametrize("cell_m", [0.03, 0.05, 0.1, 0.2])
def test_a_map_drawn_in_other_cells_agrees_with_itself(cell_m):
    grid, _, _ = cuts(0)
    coarse = bent(grid, SE2.identity(), amplitude_m=0.0, resolution_m=cell_m, rng=np.random.default_rng(0))
    found = map_agreement(grid, coarse, SE2.identity())
    assert found.wall_share > 0.95
    assert found.conflict_share < 0.02
    assert alignment_doubts(None, found) == []


@given(grids, grids, poses)
def test_two_maps_agree_alike_from_either_of_them(grid_0, grid_1, T_m0_m1):
    there = map_agreement(grid_0, grid_1, T_m0_m1)
    back = map_agreement(grid_1, grid_0, T_m0_m1.inverse())
    # A cell on another's edge, within rounding, may fall on either side.
    assert abs(there.compared_m - back.compared_m) <= 2 * max(grid_0.resolution_m, grid_1.resolution_m)


def test_maps_that_share_nothing_known_have_no_agreement():
    grid = drawn_grid(0)
    found = map_agreement(grid, constant_grid(UNKNOWN, like=grid), SE2.identity())
    assert (found.wall_share, found.conflict_share, found.compared_m) == (None, None, 0.0)


def test_a_map_agrees_wholly_with_itself_and_less_with_itself_moved():
    grid, _, _ = cuts(0)
    itself, moved = map_agreement(grid, grid, SE2.identity()), map_agreement(grid, grid, SE2(0.5, 0.3, 0.0))
    assert (itself.wall_share, itself.conflict_share) == (1.0, 0.0)
    assert itself.compared_m == pytest.approx(2 * grid.resolution_m * np.count_nonzero(grid.occupied()))
    assert moved.wall_share < 0.5
    assert moved.conflict_share > MOST_CONFLICTS


def test_real_maps_agree_best_where_they_are_registered(real_data):
    grid_0, grid_1, T_m0_c = real_maps(real_data)
    right = map_agreement(grid_0, grid_1, REAL_T_M0_M1)
    wrong = map_agreement(grid_0, grid_1, T_m0_c @ SE2(0.3, 0.0, 0.1) @ T_m0_c.inverse() @ REAL_T_M0_M1)
    assert right.wall_share > 0.6 > 0.45 > wrong.wall_share
    assert right.conflict_share < wrong.conflict_share
