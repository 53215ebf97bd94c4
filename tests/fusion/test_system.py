"""Two maps, two poses and a sighting in, one map out: on cuts of a building, whose alignment is known."""

import math
from contextlib import contextmanager
from dataclasses import replace

import numpy as np
import pytest

from rendezvous.alignment.estimate import Estimate
from rendezvous.alignment.frame_error import frame_error
from rendezvous.alignment.window import DEFAULT_SEARCH, MapWindow
from rendezvous.errors import MapError
from rendezvous.fusion.fusion_input import FusionInput, SightedMode, SightedPose, SlamSpread, sighted_pose
from rendezvous.fusion.merge import merged
from rendezvous.fusion.refinement import (
    WINDOW_TURN_RAD,
    FrameErrorPrior,
    Refiner,
    correlative_refiner,
    frame_error_prior,
    matcher_refiner,
)
from rendezvous.fusion.system import FusionResult, fuse_maps
from rendezvous.geometry.occupancy_grid import UNKNOWN, OccupancyGrid
from rendezvous.geometry.se2 import SE2
from rendezvous.models.matcher_estimator import MatcherEstimator
from rendezvous.stages.weights.trained_estimators import load
from tests.baselines.windows import cuts, window_with
from tests.conftest import ROOT
from tests.fusion.test_fusion_input import pose_of, seen_at

T_W_M0, T_W_M1 = SE2(2.0, 2.0, 0.3), SE2(11.0, 6.0, -2.0)
T_W_R0, T_W_R1 = SE2(5.6, 4.5, 0.0), SE2(7.0, 4.6, 2.4)
T_R0_R1 = (T_W_R0.inverse() @ T_W_R1).wrapped()
FINE = np.diag([0.03, 0.03, math.radians(3.0)]) ** 2
ROUGH = np.diag([0.4, 0.4, math.radians(15.0)]) ** 2


def meeting(plan: int = 0) -> FusionInput:
    grid_0, grid_1, _ = cuts(plan)
    return FusionInput(
        grid_0=grid_0,
        grid_1=grid_1,
        T_m0_r0=T_W_M0.inverse() @ T_W_R0,
        T_m1_r1=T_W_M1.inverse() @ T_W_R1,
    )


def off(result: FusionResult) -> tuple[float, float]:
    """Position [m] and heading [rad] by which T̂ is wrong where the robots met."""
    _, _, T_true = cuts(0)
    left = frame_error(result.T_m0_m1, T_true, result.T_m0_v)
    return math.hypot(left.x_m, left.y_m), abs(left.yaw_rad)


def answering(estimate: Estimate, seen: list[MapWindow] | None = None) -> Refiner:
    """A method that always gives this answer."""

    class Answer:
        name = "answer"

        def __call__(self, window: MapWindow) -> Estimate:
            if seen is not None:
                seen.append(window)
            return estimate

    return lambda prior: (Answer(), DEFAULT_SEARCH)


@pytest.fixture(scope="module")
def matcher() -> MatcherEstimator:
    weights = ROOT / "assets" / "weights" / "matcher.safetensors"
    found = load(weights.read_bytes(), "matcher", DEFAULT_SEARCH, where=str(weights), threads=1).estimator
    assert isinstance(found, MatcherEstimator)
    return found


def test_a_true_sighting_gives_the_true_alignment_unrefined():
    result = fuse_maps(meeting(), SightedPose.given(T_R0_R1, FINE), None)
    assert off(result) == pytest.approx((0.0, 0.0), abs=1e-9)
    expected = merged(meeting().grid_0, meeting().grid_1, cuts(0)[2])
    assert np.mean(result.grid.cells == expected.cells) > 0.999
    assert result.T_m0_m1 == result.T_m0_m1_initial
    assert result.estimate is None
    assert result.before == result.after


def test_the_unrefined_spread_is_the_sightings_with_the_robots_own():
    result = fuse_maps(meeting(), SightedPose.given(T_R0_R1, FINE), None)
    assert np.diag(result.covariance)[2] == pytest.approx(math.radians(3.0) ** 2 + 2 * math.radians(0.5) ** 2)
    assert math.isinf(result.degrees_of_freedom)


def test_tails_are_those_of_whoever_tells_the_spread():
    mode = SightedMode(T_r0_r1=T_R0_R1, covariance=FINE, mass=1.0, degrees_of_freedom=5.0)
    sighting = SightedPose(modes=(mode,), score=0.9)
    assert fuse_maps(meeting(), sighting, None).degrees_of_freedom == 5.0
    silent = Estimate(theta=None, reason="none", degrees_of_freedom=3.5)
    assert fuse_maps(meeting(), sighting, answering(silent)).degrees_of_freedom == 5.0
    found = Estimate(theta=SE2.identity(), covariance=FINE, degrees_of_freedom=3.5)
    assert fuse_maps(meeting(), sighting, answering(found)).degrees_of_freedom == 3.5


@pytest.mark.parametrize("error", [SE2(0.5, -0.3, 0.2), SE2(-0.6, 0.4, -0.3)])
@pytest.mark.parametrize("method", ["auto", "learned", "correlative"])
def test_every_refinement_corrects_a_rough_sighting(error: SE2, method: str, matcher: MatcherEstimator):
    refiner = (
        correlative_refiner
        if method == "correlative"
        else matcher_refiner(matcher, with_prior=method == "auto")
    )
    result = fuse_maps(meeting(), SightedPose.given(T_R0_R1 @ error, ROUGH), refiner)
    position_m, heading_rad = off(result)
    assert position_m < 0.1
    assert heading_rad < math.radians(1.5)
    assert result.after.wall_share > result.before.wall_share
    assert result.verdict.accepted, str(result.verdict)


def test_a_reading_with_front_and_back_confused_is_set_right_by_the_maps(matcher: MatcherEstimator):
    flipped = T_R0_R1 @ SE2(0.0, 0.0, math.pi)
    sighting = sighted_pose([pose_of((flipped, FINE, 0.6), (T_R0_R1, FINE, 0.4))])
    result = fuse_maps(meeting(), sighting, matcher_refiner(matcher, with_prior=True))
    assert off(result)[1] < math.radians(1.5)
    assert result.verdict.accepted, str(result.verdict)
    alone = fuse_maps(meeting(), sighting, None)
    assert "the sighting can be read in 2 ways" in str(alone.verdict)


def test_an_overconfident_sighting_does_not_ruin_the_map(matcher: MatcherEstimator):
    wrong = T_R0_R1 @ SE2(0.9, 0.6, 0.5)
    result = fuse_maps(meeting(), SightedPose.given(wrong, FINE), matcher_refiner(matcher, with_prior=True))
    assert off(result)[0] < 0.15
    assert "more than the sighting's covariance allows" in str(result.verdict)


def test_a_perfect_answer_in_its_turned_window_gives_the_true_alignment():
    """The window lies along neither map's cells; what is found there comes back along the axes of m0."""
    rough = T_R0_R1 @ SE2(0.5, -0.3, 0.2)
    sighting = sighted_pose([pose_of((rough, ROUGH, 0.6), (rough @ SE2(1.0, 0.0, 0.0), ROUGH, 0.4))])
    prior_w = frame_error_prior(sighting, meeting().T_m0_r0, slam=SlamSpread())
    first = fuse_maps(meeting(), sighting, None)
    theta_v = frame_error(first.T_m0_m1, cuts(0)[2], first.T_m0_v)
    spread = np.diag([0.09, 0.01, 0.04])
    turns, windows = [], []

    def refiner(prior: FrameErrorPrior):
        at_w, at_v = prior_w.modes[1].mean, prior.modes[1].mean
        turns.append(math.atan2(at_w.y_m, at_w.x_m) - math.atan2(at_v.y_m, at_v.x_m))
        R = SE2(0.0, 0.0, turns[0])
        seen = Estimate(theta=R.inverse() @ theta_v @ R, covariance=R.matrix().T @ spread @ R.matrix())
        return answering(seen, windows)(prior)

    result = fuse_maps(meeting(), sighting, refiner)
    assert abs(math.remainder(turns[0], 2.0 * math.pi)) == pytest.approx(WINDOW_TURN_RAD)
    assert off(result) == pytest.approx((0.0, 0.0), abs=1e-9)
    assert result.covariance == pytest.approx(spread)
    assert windows[0].sight is not None


@pytest.mark.parametrize(
    ("estimate", "said"),
    [
        (
            Estimate(theta=None, reason="a map has no walls"),
            "could not refine the alignment: a map has no walls",
        ),
        (Estimate(theta=SE2.identity(), ambiguous=True), "in more than one way"),
        (Estimate(theta=SE2(DEFAULT_SEARCH.xy_m, 0.0, 0.0)), "at the edge of the search"),
        (Estimate(theta=SE2.identity(), covariance=ROUGH), r"known to ±0.40 m and ±15.0° only"),
        (Estimate(theta=SE2(0.9, 0.0, 0.0)), "of the shared walls coincide after the refinement"),
    ],
)
def test_doubts_of_a_refinement_are_told(estimate: Estimate, said: str):
    result = fuse_maps(meeting(), SightedPose.given(T_R0_R1), answering(estimate))
    assert not result.verdict.accepted
    assert said in str(result.verdict)


def test_without_an_answer_the_sighting_is_used():
    result = fuse_maps(
        meeting(), SightedPose.given(T_R0_R1, FINE), answering(Estimate(theta=None, reason="none"))
    )
    assert result.T_m0_m1 == result.T_m0_m1_initial
    assert result.covariance is not None


def test_doubts_of_a_sighting_are_told():
    unsure = fuse_maps(meeting(), sighted_pose([seen_at(T_R0_R1, FINE, score=0.2)]), None)
    assert "detection scores 0.20" in str(unsure.verdict)
    elsewhere = seen_at(T_R0_R1 @ SE2(2.0, 0.0, 0.0), FINE)
    contradicted = fuse_maps(meeting(), sighted_pose([seen_at(T_R0_R1, FINE)] * 2 + [elsewhere]), None)
    assert "image 2 shows the robot elsewhere" in str(contradicted.verdict)
    assert off(contradicted) == pytest.approx((0.0, 0.0), abs=1e-6)


@pytest.mark.parametrize("number", [0, 1])
def test_a_robot_that_stands_off_its_map_is_told(number: int):
    elsewhere = replace(meeting(), **{f"T_m{number}_r{number}": SE2(-60.0, 3.0, 0.0)})
    told = str(fuse_maps(elsewhere, SightedPose.given(T_R0_R1, FINE), None).verdict)
    assert f"robot {number} stands at x -60.00 m, y 3.00 m, where map {number} knows nothing" in told
    assert told.count("knows nothing") == 1


def test_maps_that_share_nothing_are_told():
    apart = replace(meeting(), T_m0_r0=SE2(60.0, 0.0, 0.0))
    result = fuse_maps(apart, SightedPose.given(T_R0_R1, FINE), None)
    assert result.overlap == 0.0
    assert "share too little to check the alignment: 0.0 m of walls" in str(result.verdict)


def test_a_map_that_knows_nothing_is_an_error():
    empty = OccupancyGrid(cells=np.full((4, 5), UNKNOWN, np.uint8), resolution_m=0.05, T_m_g=SE2.identity())
    with pytest.raises(MapError, match="map 1: none of its 20 cells is known"):
        replace(meeting(), grid_1=empty)


def test_a_search_follows_the_sightings_covariance():
    narrow, wide = (
        correlative_refiner(
            frame_error_prior(SightedPose.given(T_R0_R1, c), SE2.identity(), slam=SlamSpread())
        )[1]
        for c in (FINE, ROUGH)
    )
    assert narrow.xy_m < wide.xy_m
    assert correlative_refiner(None)[1] == DEFAULT_SEARCH


def test_every_part_can_be_timed():
    entered = []

    @contextmanager
    def part(name: str):
        entered.append(name)
        yield

    fuse_maps(meeting(), SightedPose.given(T_R0_R1, FINE), None, part=part)
    assert entered == ["refine", "merge", "check"]


def test_the_matchers_answer_is_what_it_was_when_it_was_measured(matcher: MatcherEstimator):
    estimate = matcher(window_with(SE2(1.1, -0.6, 0.4), turn_rad=1.0))
    assert estimate.theta.as_array() == pytest.approx([1.103975, -0.593954, 0.403279], abs=1e-4)
    sigmas = np.sqrt(np.diag(estimate.covariance))
    assert sigmas == pytest.approx([0.0507601, 0.0500929, 0.0153206], rel=3e-3)
    assert not estimate.ambiguous
