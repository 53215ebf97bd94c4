"""The prior of the frame error, against poses drawn at random."""

import math

import numpy as np
import pytest
from rendezvous.alignment.frame_error import frame_error, initial_alignment, meeting_point
from rendezvous.fusion.fusion_input import SlamSpread
from rendezvous.fusion.prior import NARROWEST, WIDEST, adjoint, frame_error_prior
from rendezvous.fusion.sighted_pose import OUTLIER_SHARE, SightedMode, SightedPose
from rendezvous.geometry.se2 import SE2, Array

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
