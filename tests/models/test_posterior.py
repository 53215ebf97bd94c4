"""Peaks, moments, density and priors of posteriors over SE(2), against analytic Gaussians."""

import math

import numpy as np
import pytest
from scipy import stats

from rendezvous.geometry.se2 import SE2, wrap_angle
from rendezvous.models.posterior import WHOLE, Gaussian, Posterior, RefinedPosterior, log_prior

SHAPE = np.array([[0.010, 0.004, 0.001], [0.004, 0.006, -0.001], [0.001, -0.001, 0.003]])


def grid_of(*gaussians: tuple[float, Gaussian], half_yaw_rad: float = 0.8, circle: bool = False) -> Posterior:
    """The posterior of a mixture of Gaussians, weights first, on a grid of 0.04 m and 0.02 rad or so."""
    count = 180 if circle else 81
    headings_rad = (
        np.linspace(-math.pi, math.pi, count, endpoint=False)
        if circle
        else np.linspace(-half_yaw_rad, half_yaw_rad, count)
    )
    ys_m, xs_m = np.linspace(-1.2, 1.2, 61), np.linspace(-1.6, 1.6, 81)
    p = sum(
        weight * np.exp(log_prior([gaussian], headings_rad, ys_m, xs_m)) for weight, gaussian in gaussians
    )
    return Posterior(
        headings_rad=headings_rad, ys_m=ys_m, xs_m=xs_m, log_p_HYX=np.log(p + 1e-300)
    ).normalised()


def test_moments_are_those_of_the_gaussian_that_was_drawn_on_the_grid():
    gaussian = Gaussian(mean=SE2(0.31, -0.22, 0.13), covariance=SHAPE)
    posterior = grid_of((1.0, gaussian))
    (mode,) = posterior.modes(1)
    found = posterior.mean_and_covariance(mode, box=WHOLE)
    cell = SE2(0.0, 0.0, -0.13).matrix() @ np.diag([0.04**2, 0.04**2, 0.02**2]) / 12.0
    assert found.mean.as_array() == pytest.approx(gaussian.mean.as_array(), abs=1e-3)
    assert found.covariance == pytest.approx(SHAPE + cell, abs=2e-4)


def test_covariance_is_of_the_components_seen_from_the_mean():
    narrow_ahead = Gaussian(mean=SE2(0.0, 0.0, math.pi / 2), covariance=np.diag([0.002, 0.03, 0.001]))
    posterior = grid_of((1.0, narrow_ahead), circle=True)
    found = posterior.mean_and_covariance(posterior.modes(1)[0], box=WHOLE)
    assert np.diag(found.covariance) == pytest.approx([0.002, 0.03, 0.001], rel=0.12)
    along_the_axes = posterior.moments(found.mean, box=WHOLE)
    assert np.diag(along_the_axes.covariance)[:2] == pytest.approx([0.03, 0.002], rel=0.12)


def test_modes_are_the_components_of_a_mixture_with_their_weights():
    tight = np.diag([0.004, 0.004, 0.0004])
    first, second = SE2(0.8, 0.4, 0.4), SE2(-0.8, -0.4, -0.2)
    posterior = grid_of(
        (0.3, Gaussian(mean=second, covariance=tight)), (0.7, Gaussian(mean=first, covariance=tight))
    )
    modes = posterior.modes(2)
    assert [mode.mass for mode in modes] == pytest.approx([0.7, 0.3], abs=1e-3)
    assert modes[0].peak.as_array() == pytest.approx(first.as_array(), abs=0.021)
    assert modes[1].peak.as_array() == pytest.approx(second.as_array(), abs=0.021)


def test_a_peak_at_the_seam_of_the_circle_is_one_mode():
    spread = np.diag([0.004, 0.004, 0.002])
    posterior = grid_of((1.0, Gaussian(mean=SE2(0.1, 0.0, math.pi), covariance=spread)), circle=True)
    first, second = posterior.modes(2)
    assert first.mass > 0.99 > 0.01 > second.mass
    found = posterior.mean_and_covariance(first)
    assert abs(wrap_angle(found.mean.yaw_rad - math.pi)) < 1e-3
    assert found.covariance[2, 2] == pytest.approx(0.002, rel=0.1)


def test_a_prior_multiplies_as_gaussians_do():
    likelihood = Gaussian(mean=SE2(0.3, -0.1, 0.0), covariance=SHAPE)
    prior = Gaussian(mean=SE2(-0.1, 0.2, 0.0), covariance=np.diag([0.02, 0.01, 0.004]))
    posterior = grid_of((1.0, likelihood)).times_prior(prior)
    # On the grid of components both are normal in (x, y, yaw), as both means have yaw 0.
    P, Q = np.linalg.inv(SHAPE), np.linalg.inv(prior.covariance)
    covariance = np.linalg.inv(P + Q)
    mean = covariance @ (P @ likelihood.mean.as_array() + Q @ prior.mean.as_array())
    found = posterior.moments(posterior.modes(1)[0].peak, box=WHOLE)
    assert np.exp(posterior.log_p_HYX).sum() == pytest.approx(1.0)
    assert found.mean.as_array() == pytest.approx(mean, abs=1e-3)
    cell = np.diag([0.04**2, 0.04**2, 0.02**2]) / 12.0
    assert found.covariance == pytest.approx(covariance + cell, abs=2e-4)


def test_a_prior_beyond_the_seam_counts_the_short_way_round():
    flat = Posterior(
        headings_rad=np.linspace(-math.pi, math.pi, 72, endpoint=False),
        ys_m=np.array([0.0, 1.0]),
        xs_m=np.array([0.0, 1.0]),
        log_p_HYX=np.full((72, 2, 2), -math.log(72 * 4)),
    )
    prior = Gaussian(mean=SE2(0.0, 0.0, math.pi - 0.02), covariance=np.diag([1.0, 1.0, 0.01]))
    by_heading = np.exp(flat.times_prior(prior).log_p_HYX).sum((1, 2))
    assert by_heading[1] == pytest.approx(
        by_heading[0] * math.exp(-((0.02 + math.radians(5)) ** 2) / 0.02 + 0.02)
    )


def test_density_is_that_of_the_gaussian():
    gaussian = Gaussian(mean=SE2(0.1, 0.2, 0.0), covariance=4.0 * SHAPE)
    posterior = grid_of((1.0, gaussian))
    truth = stats.multivariate_normal(mean=[0.1, 0.2, 0.0], cov=4.0 * SHAPE)
    for theta in ((0.1, 0.2, 0.0), (0.21, 0.17, 0.05), (-0.1, 0.3, -0.11)):
        assert posterior.log_density(SE2(*theta)) == pytest.approx(truth.logpdf(theta), abs=0.05)
    assert posterior.log_density(SE2(5.0, 0.0, 0.0)) == -math.inf


@pytest.mark.parametrize("circle", [True, False])
def test_density_integrates_to_one(circle):
    rng = np.random.default_rng(3)
    count = 6 if circle else 4
    step_rad = math.tau / count if circle else 0.3
    posterior = Posterior(
        headings_rad=step_rad * np.arange(count),
        ys_m=np.array([0.0, 0.5, 1.0]),
        xs_m=np.array([-0.4, 0.0]),
        log_p_HYX=rng.normal(0.0, 2.0, (count, 3, 2)),
    ).normalised()
    # The midpoint rule is exact for a piecewise linear density whose corners lie between its points; it falls
    # to zero a step beyond the outermost cells, which a circle does not have.
    halves = np.arange(-2, 2 * (max(count, 3) + 1)) / 2.0 + 0.25
    turns = halves[(halves > -1.0) & (halves < count)] if not circle else halves[2 : 2 + 2 * count]
    thetas = [SE2(0.4 * x - 0.4, 0.5 * y, step_rad * turn) for turn in turns for y in halves for x in halves]
    total = sum(math.exp(posterior.log_density(theta)) for theta in thetas)
    assert total * (0.5 * step_rad) * 0.25 * 0.2 == pytest.approx(1.0, abs=1e-9)


def test_what_is_left_without_a_peak_is_what_the_peak_did_not_claim():
    tight = np.diag([0.004, 0.004, 0.0004])
    posterior = grid_of(
        (0.3, Gaussian(mean=SE2(-0.8, -0.4, -0.2), covariance=tight)),
        (0.7, Gaussian(mean=SE2(0.8, 0.4, 0.4), covariance=tight)),
    )
    (mode,) = posterior.modes(1)
    rest = posterior.without(mode.peak)
    assert np.exp(rest.log_p_HYX).sum() == pytest.approx(1.0 - mode.mass)
    assert rest.modes(1)[0] == posterior.modes(2)[1]


def test_a_refined_posterior_weighs_its_pieces():
    close = grid_of((1.0, Gaussian(mean=SE2(0.2, 0.1, 0.1), covariance=0.2 * SHAPE)))
    other = grid_of((1.0, Gaussian(mean=SE2(-0.2, 0.1, 0.1), covariance=0.2 * SHAPE)))
    nothing = close.without(SE2.identity(), box=WHOLE)
    refined = RefinedPosterior(
        coarse=close, pieces=(close, other), masses=np.array([0.75, 0.25]), rest=nothing
    )
    theta = SE2(0.0, 0.1, 0.1)
    near, far = (math.exp(piece.log_density(theta)) for piece in (close, other))
    density = 0.99 * (0.75 * near + 0.25 * far) + 0.01 * near  # the coarse one is the first here
    assert math.exp(refined.log_density(theta)) == pytest.approx(density)
    assert refined.best().mean.as_array() == pytest.approx([0.2, 0.1, 0.1], abs=1e-3)


@pytest.mark.parametrize(("weights", "shares"), [((1.0, 1.0), (0.5, 0.5)), ((0.3, 0.1), (0.75, 0.25))])
def test_several_priors_are_a_mixture_by_their_weights(
    weights: tuple[float, float], shares: tuple[float, float]
):
    flat = grid_of((1.0, Gaussian(mean=SE2.identity(), covariance=1e6 * np.eye(3))))
    tight, wide = np.diag([0.004, 0.004, 0.0004]), np.diag([0.01, 0.01, 0.001])
    posterior = flat.times_prior(
        Gaussian(mean=SE2(0.8, 0.4, 0.4), covariance=tight, weight=weights[0]),
        Gaussian(mean=SE2(-0.8, -0.4, -0.2), covariance=wide, weight=weights[1]),
    )
    assert [mode.mass for mode in posterior.modes(2)] == pytest.approx(shares, abs=1e-3)


def test_a_prior_s_search_reaches_its_tails_wherever_it_looks():
    prior = Gaussian(mean=SE2(0.5, -1.0, math.pi / 2), covariance=np.diag([0.3, 0.1, 0.2]) ** 2)
    search = prior.search(sigmas=2.0)
    # Its x axis looks along +y of the window.
    assert search.xy_m == pytest.approx(1.0 + 0.6)
    assert search.yaw_rad == pytest.approx(math.pi / 2 + 0.4)
    assert Gaussian(mean=SE2(0.0, 0.0, 3.0), covariance=np.eye(3)).search().yaw_rad == math.pi


def test_a_distribution_seen_in_cells_is_as_much_wider_as_a_cell_is():
    seen = Gaussian(mean=SE2(1.0, 2.0, 3.0), covariance=np.diag([0.01, 0.02, 0.03])).through_cells(0.6, 0.3)
    assert seen.covariance == pytest.approx(np.diag([0.01 + 0.03, 0.02 + 0.03, 0.03 + 0.0075]))
    assert seen.mean == SE2(1.0, 2.0, 3.0)


def test_a_grid_holds_what_lies_within_its_cells():
    grid = Posterior(
        headings_rad=np.pi + np.array([-0.1, 0.0, 0.1]),
        ys_m=np.array([1.0, 1.2, 1.4, 1.6, 1.8]),
        xs_m=np.array([-0.4, 0.0, 0.4]),
        log_p_HYX=np.zeros((3, 5, 3)),
    )
    for x_m, y_m, yaw_rad, held in (
        (0.59, 1.89, -np.pi + 0.149, True),
        (-0.59, 0.91, np.pi - 0.149, True),
        (0.61, 1.4, np.pi, False),
        (-0.61, 1.4, np.pi, False),
        (0.0, 1.91, np.pi, False),
        (0.0, 0.89, np.pi, False),
        (0.0, 1.4, -np.pi + 0.151, False),
        (0.0, 1.4, np.pi - 0.151, False),
    ):
        assert grid.holds(SE2(x_m, y_m, yaw_rad)) == held
