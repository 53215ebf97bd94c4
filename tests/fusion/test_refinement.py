"""The window in which the frame error is looked for."""

import math

import numpy as np
import pytest

from rendezvous.alignment.estimate import Estimate
from rendezvous.alignment.frame_error import corrected, frame_error, initial_alignment, meeting_point
from rendezvous.alignment.window import DEFAULT_SEARCH, ROBOT_CELL, MapWindow, SearchRange
from rendezvous.fusion.fusion_input import OUTLIER_SHARE, FusionInput, SightedMode, SightedPose, SlamSpread
from rendezvous.fusion.refinement import (
    NARROWEST,
    WIDEST,
    WINDOW_TURN_RAD,
    FrameErrorPrior,
    adjoint,
    frame_error_prior,
    refined,
)
from rendezvous.geometry.se2 import SE2, Array
from rendezvous.models.posterior import Gaussian
from tests.fusion.grids import drawn_grid

T_R0_R1 = SE2(0.7, 0.2, 2.0)


def looked_at(*, yaw_0: float, yaw_1: float) -> tuple[MapWindow, float, FusionInput, SE2]:
    """The window, its yaw in m0, the meeting and T̃; the maps' cells lie at these yaws in m0."""
    T_m0_r0, T_m0_m1 = SE2(0.3, -0.4, 0.5), SE2(1.0, 2.0, 0.7)
    meeting = FusionInput(
        grid_0=drawn_grid(0, T_m_g=SE2(-1.0, 0.5, yaw_0)),
        grid_1=drawn_grid(1, T_m_g=SE2(0.4, 0.2, yaw_1 - T_m0_m1.yaw_rad)),
        T_m0_r0=T_m0_r0,
        T_m1_r1=T_m0_m1.inverse() @ T_m0_r0 @ T_R0_R1,
    )
    T = initial_alignment(T_m0_r0, T_R0_R1, meeting.T_m1_r1)
    # A mean along x of w: where it points in the window tells how the window is turned.
    along_x = Gaussian(mean=SE2(1.0, 0.0, 0.0), covariance=np.eye(3))
    seen: list[MapWindow] = []
    yaws: list[float] = []

    class Answer:
        name = "answer"

        def __call__(self, window: MapWindow) -> Estimate:
            seen.append(window)
            return Estimate(theta=None, reason="only looks")

    def refiner(prior: FrameErrorPrior):
        yaws.append(-math.atan2(prior.outlier.mean.y_m, prior.outlier.mean.x_m))
        return Answer(), DEFAULT_SEARCH

    refined(
        meeting,
        T,
        meeting_point(T, meeting.T_m1_r1),
        refiner,
        FrameErrorPrior(modes=(along_x,), outlier=along_x, degrees_of_freedom=(math.inf,)),
    )
    return seen[0], yaws[0], meeting, T


@pytest.mark.parametrize("yaw_0", [0.0, 0.3])
@pytest.mark.parametrize("between_deg", [0.0, 22.5, -22.5, 45.0, 67.5, 112.5, 200.0])
def test_the_window_lies_along_the_cells_of_neither_map(yaw_0: float, between_deg: float):
    yaw_1 = yaw_0 + math.radians(between_deg)
    _, yaw_rad, _, _ = looked_at(yaw_0=yaw_0, yaw_1=yaw_1)
    for along in (yaw_0, yaw_1):
        # Cells look the same after a quarter turn.
        assert abs(math.remainder(yaw_rad - along, 0.5 * math.pi)) >= WINDOW_TURN_RAD - 1e-9


def test_the_window_shows_each_robot_where_it_stood_in_its_own_map():
    window, yaw_rad, meeting, T = looked_at(yaw_0=0.2, yaw_1=1.0)
    T_m0_v = meeting_point(T, meeting.T_m1_r1) @ SE2(0.0, 0.0, yaw_rad)
    assert window.sight is not None
    for sight, T_m0_r in zip(window.sight, (meeting.T_m0_r0, T @ meeting.T_m1_r1), strict=True):
        T_v_r = T_m0_v.inverse() @ T_m0_r
        row, col = (np.argwhere(sight == ROBOT_CELL) + 0.5).mean(axis=0) - 0.5 * len(sight)
        assert (col * window.cell_m, row * window.cell_m) == pytest.approx((T_v_r.x_m, T_v_r.y_m), abs=0.05)


def test_an_answer_in_the_turned_window_comes_back_along_the_axes_of_map_0():
    theta, spread = SE2(0.3, -0.1, 0.2), np.diag([0.09, 0.01, 0.04])
    _, yaw_rad, given, T = looked_at(yaw_0=0.2, yaw_1=1.0)

    def refiner(prior: FrameErrorPrior | None):
        return lambda window: Estimate(theta=theta, covariance=spread), DEFAULT_SEARCH

    found = refined(given, T, meeting_point(T, given.T_m1_r1), refiner, None)
    R = SE2(0.0, 0.0, yaw_rad)
    assert found.estimate.theta.as_array() == pytest.approx((R @ theta @ R.inverse()).as_array())
    ahead = R.matrix()[:, 0]  # of the window: there the spread is widest
    assert ahead @ found.estimate.covariance @ ahead == pytest.approx(0.09)
    assert not found.at_edge


@pytest.mark.parametrize(
    ("theta", "at_edge"),
    [
        (SE2(0.89, -0.89, 0.48), False),
        (SE2(-0.91, 0.0, 0.0), True),
        (SE2(0.0, 0.91, 0.0), True),
        (SE2(0.0, 0.0, -0.49), True),
    ],
)
def test_an_answer_close_to_the_end_of_its_search_is_at_the_edge(theta: SE2, at_edge: bool):
    _, _, given, T = looked_at(yaw_0=0.0, yaw_1=0.0)
    for search, there in (
        (SearchRange(xy_m=1.0, yaw_rad=0.5), at_edge),
        (SearchRange(xy_m=2.0, yaw_rad=math.pi), False),
    ):
        answer = Estimate(theta=theta), search
        found = refined(
            given, T, meeting_point(T, given.T_m1_r1), lambda _, a=answer: (lambda w: a[0], a[1]), None
        )
        assert found.at_edge == there
        assert found.search == search


def test_what_an_estimate_leaves_lies_along_the_axes_of_map_0_however_far_it_turns():
    T_true, T_m0_v, theta = SE2(2.0, -1.0, 1.0), SE2(5.0, 3.0, 0.0), SE2(0.5, -0.3, 0.7)
    T_initial = T_m0_v @ theta @ T_m0_v.inverse() @ T_true
    T_off = SE2(0.1, 0.0, 0.0) @ T_true  # along x of m0
    theta_hat = frame_error(T_initial, T_off, T_m0_v)
    assert corrected(T_initial, theta_hat, T_m0_v).as_array() == pytest.approx(T_off.wrapped().as_array())
    left = (theta_hat.inverse() @ theta).wrapped()
    assert left.as_array() == pytest.approx([0.1, 0.0, 0.0])


T_M0_R0, T_M1_R1 = SE2(4.0, -3.0, 1.2), SE2(-2.0, 6.0, -2.7)
SEEN = SE2(1.8, 0.4, 2.0)
EXACT = SlamSpread(position_m=0.0, heading_rad=0.0)
SHAPE = np.array([[4e-4, 1e-4, 1e-5], [1e-4, 9e-4, -2e-5], [1e-5, -2e-5, 1e-4]])


def errors(T_r0_r1_true: SE2, own: Array | None = None) -> SE2:
    """θ_v of T̃ made of `SEEN` when robot 1 stood elsewhere, and with errors of both robots' own poses."""
    own_0, own_1 = (SE2.identity(), SE2.identity()) if own is None else (SE2.from_array(e) for e in own)
    T_estimated = initial_alignment(T_M0_R0, SEEN, T_M1_R1)
    T_true = initial_alignment(T_M0_R0 @ own_0, T_r0_r1_true, T_M1_R1 @ own_1)
    return frame_error(T_estimated, T_true, meeting_point(T_estimated, T_M1_R1))


def test_adjoint_carries_small_motions():
    T, small = SE2(2.0, -1.0, 0.7), np.array([1e-5, -2e-5, 1e-5])
    carried = T @ SE2.from_array(small) @ T.inverse()
    assert carried.as_array() == pytest.approx(adjoint(T) @ small, abs=1e-9)


def test_the_prior_has_the_spread_of_the_frame_errors_that_the_sighting_leaves():
    (part,) = frame_error_prior(SightedPose.given(SEEN, SHAPE), T_M0_R0, slam=EXACT).modes
    rng = np.random.default_rng(0)
    drawn = [errors(SEEN @ SE2.from_array(d)) for d in rng.multivariate_normal(np.zeros(3), SHAPE, 4000)]
    off = np.array([(part.mean.inverse() @ theta).wrapped().as_array() for theta in drawn])
    assert np.cov(off.T) == pytest.approx(part.covariance, abs=5e-5)
    assert part.mean.as_array() == pytest.approx(np.zeros(3), abs=1e-12)


def test_another_mode_lies_where_its_frame_errors_do():
    other = SEEN @ SE2(0.1, -0.05, math.pi - 0.1)
    modes = (
        SightedMode(T_r0_r1=SEEN, covariance=SHAPE, mass=0.7),
        SightedMode(T_r0_r1=other, covariance=2.0 * SHAPE, mass=0.3),
    )
    first, second = frame_error_prior(SightedPose(modes=modes), T_M0_R0, slam=EXACT).modes
    rng = np.random.default_rng(1)
    drawn = [
        errors(other @ SE2.from_array(d)) for d in rng.multivariate_normal(np.zeros(3), 2.0 * SHAPE, 4000)
    ]
    off = np.array([(second.mean.inverse() @ theta).wrapped().as_array() for theta in drawn])
    assert off.mean(axis=0) == pytest.approx(np.zeros(3), abs=3e-3)
    assert np.cov(off.T) == pytest.approx(second.covariance, abs=1e-4)
    assert (first.weight, second.weight) == pytest.approx(
        (0.7 * (1 - OUTLIER_SHARE), 0.3 * (1 - OUTLIER_SHARE))
    )


def test_the_robots_own_errors_are_in_the_spread():
    slam = SlamSpread(position_m=0.03, heading_rad=0.02)
    (part,) = frame_error_prior(SightedPose.given(SEEN, SHAPE), T_M0_R0, slam=slam).modes
    rng = np.random.default_rng(2)
    drawn = [
        errors(SEEN @ SE2.from_array(d), rng.normal(0.0, [0.03, 0.03, 0.02], (2, 3)))
        for d in rng.multivariate_normal(np.zeros(3), SHAPE, 6000)
    ]
    assert np.cov(np.array([theta.as_array() for theta in drawn]).T) == pytest.approx(
        part.covariance, abs=3e-4
    )


def test_a_prior_seen_from_a_turned_window_is_that_of_the_turned_errors():
    prior = frame_error_prior(SightedPose.given(SEEN, SHAPE), T_M0_R0, slam=EXACT)
    R = SE2(0.0, 0.0, 0.6)
    theta = SE2(0.02, -0.01, 0.005)
    (part,), (turned,) = prior.modes, prior.turned(0.6).modes
    d, e = theta.as_array(), (R.inverse() @ theta @ R).as_array()
    assert e @ np.linalg.solve(turned.covariance, e) == pytest.approx(d @ np.linalg.solve(part.covariance, d))


def test_searches_reach_what_they_should_within_what_makes_sense():
    tight = frame_error_prior(SightedPose.given(SEEN, 1e-6 * np.eye(3)), T_M0_R0, slam=EXACT)
    assert tight.search(with_outlier=False) == NARROWEST
    assert tight.search(with_outlier=True).xy_m == pytest.approx(3.5)
    vague = frame_error_prior(SightedPose.given(SEEN, 100.0 * np.eye(3)), T_M0_R0, slam=EXACT)
    assert vague.search(with_outlier=False) == WIDEST


def test_an_unknown_error_gives_no_prior():
    assert frame_error_prior(SightedPose.given(SEEN), T_M0_R0, slam=EXACT) is None


def test_only_what_the_sighting_does_not_allow_is_surprising():
    prior = frame_error_prior(SightedPose.given(SEEN, SHAPE), T_M0_R0, slam=EXACT)
    assert prior.surprise(SE2(0.01, 0.01, 0.005), np.zeros((3, 3))) < 0.5
    assert prior.surprise(SE2(0.5, 0.0, 0.0), np.zeros((3, 3))) > 0.999
    assert prior.surprise(SE2(0.5, 0.0, 0.0), np.eye(3)) < 0.5


def test_heavy_tails_make_a_far_estimate_less_surprising():
    """An error drawn from the prior itself is more surprising than p in a share 1 - p of cases."""
    rng, tails = np.random.default_rng(5), 5.0
    heavy = SightedMode(T_r0_r1=SEEN, covariance=SHAPE, mass=1.0, degrees_of_freedom=tails)
    prior = frame_error_prior(SightedPose(modes=(heavy,)), T_M0_R0, slam=EXACT)
    (mode,) = prior.modes
    factors = np.sqrt((tails - 2.0) / rng.chisquare(tails, 4000))
    errors = rng.multivariate_normal(np.zeros(3), mode.covariance, 4000) * factors[:, None]
    found = np.array(
        [prior.surprise(mode.mean @ SE2.from_array(error), np.zeros((3, 3))) for error in errors]
    )
    for p in (0.5, 0.9, 0.99):
        assert np.mean(found > p) == pytest.approx(1.0 - p, abs=3.0 * np.sqrt(p * (1.0 - p) / 4000))


def test_a_sighting_of_something_else_is_two_in_a_hundred_within_the_papers_range():
    prior = frame_error_prior(SightedPose.given(SEEN, SHAPE), T_M0_R0, slam=EXACT)
    assert prior.outlier.weight == 0.02
    assert prior.outlier.mean == SE2.identity()
    assert prior.outlier.covariance == pytest.approx(np.diag([1.0, 1.0, (0.5 * math.pi) ** 2]))
    assert sum(part.weight for part in prior.parts) == pytest.approx(1.0)
    assert prior.search(with_outlier=True) == SearchRange(xy_m=3.5, yaw_rad=math.pi)


def test_a_search_reaches_three_and_a_half_deviations_of_the_farthest_mode():
    sigmas = np.array([0.2, 0.1, 0.05])
    modes = (
        SightedMode(T_r0_r1=SEEN, covariance=np.diag(sigmas**2), mass=0.7),
        SightedMode(T_r0_r1=SEEN @ SE2(0.0, 0.0, 0.4), covariance=np.diag(sigmas**2), mass=0.3),
    )
    at_phi = SE2(0.0, 0.0, -SEEN.yaw_rad)  # so that the axes of m0 are those of the mode
    search = frame_error_prior(SightedPose(modes=modes), at_phi, slam=EXACT).search(with_outlier=False)
    assert search.yaw_rad == pytest.approx(0.4 + 3.5 * 0.05)
    alone = frame_error_prior(SightedPose(modes=modes[:1]), at_phi, slam=EXACT).search(with_outlier=False)
    assert (alone.xy_m, alone.yaw_rad) == pytest.approx((3.5 * 0.2, 3.5 * 0.05))
