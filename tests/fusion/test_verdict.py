"""Doubts about a fused map, each by itself and at its limit."""

import math

import numpy as np
import pytest
from rendezvous.alignment.estimate import WRONG_M, WRONG_RAD, Estimate
from rendezvous.alignment.window import DEFAULT_SEARCH
from rendezvous.fusion.agreement import MapAgreement
from rendezvous.fusion.fusion_input import FusionInput, SlamSpread
from rendezvous.fusion.prior import frame_error_prior
from rendezvous.fusion.refinement import RefinedAlignment
from rendezvous.fusion.sighted_pose import SightedMode, SightedPose
from rendezvous.fusion.verdict import alignment_doubts, pose_doubts, refinement_doubts, sighting_doubts
from rendezvous.geometry.occupancy_grid import FREE, UNKNOWN, OccupancyGrid
from rendezvous.geometry.se2 import SE2, Array

SIGMA = np.diag([0.1, 0.1, math.radians(3.0)]) ** 2


def agreeing(
    *, wall_share: float | None = 0.95, conflict_share: float | None = 0.02, compared: int = 400
) -> MapAgreement:
    return MapAgreement(
        wall_share=wall_share, conflict_share=conflict_share, compared=compared, known_in_both=5000
    )


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
        (agreeing(wall_share=0.61, conflict_share=0.079, compared=30), None),
        (agreeing(conflict_share=None), None),
        (agreeing(wall_share=0.59), "only 59% of the walls that both maps show coincide"),
        (agreeing(conflict_share=0.09), "contradict each other in 9% of what both know"),
        (agreeing(compared=29), "share too little to check the alignment: 29 cells of walls"),
        (agreeing(wall_share=None, compared=0), "share too little to check the alignment: 0 cells of walls"),
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


@pytest.mark.parametrize(("away_m", "doubted"), [(0.2, False), (0.3, True)])
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
