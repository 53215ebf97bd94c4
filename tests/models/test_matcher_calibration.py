"""Confidence that agrees with errors."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
import torch

from rendezvous.alignment.frame_error import ellipsoid_probability, nees
from rendezvous.alignment.window import SearchRange
from rendezvous.errors import ConfigError
from rendezvous.geometry.se2 import SE2, Array
from rendezvous.models.matcher import Matcher, MatcherConfig
from rendezvous.models.matcher_calibration import (
    CalibrationPair,
    MatcherCalibration,
    fitted,
    least_trusted_mass,
    most_likely_spread,
    weights_of_witnesses,
)
from rendezvous.models.matcher_estimator import MatcherEstimator
from rendezvous.models.posterior import Gaussian, Posterior, RefinedPosterior, Witnesses
from tests.models.worlds import misplaced, rooms

SMALL = MatcherConfig(cell_m=0.1, coarse_factor=2, fine_factor=1, channels=8, dilations=(1,))


def _spread(rng: np.random.Generator, count: int) -> Array:
    """(P, 3, 3) covariances of a centimetre or so and half a degree, no two alike."""
    root = rng.normal(size=(count, 3, 3)) * np.array([0.01, 0.01, 0.008])[:, None]
    return root @ root.transpose(0, 2, 1) + np.diag([1e-5, 1e-5, 1e-5])


def _drawn(rng: np.random.Generator, covariance: Array) -> Array:
    return (np.linalg.cholesky(covariance) @ rng.normal(size=(len(covariance), 3, 1)))[..., 0]


@pytest.mark.parametrize(
    ("factor", "floor_m", "floor_rad", "tails"), [(0.25, 0.0, 0.0, 100.0), (1.0, 0.01, 0.005, 4.0)]
)
def test_ellipsoids_of_other_pairs_cover_as_often_as_they_say(factor, floor_m, floor_rad, tails):
    rng = np.random.default_rng(0)
    told = _spread(rng, 1600)
    true = factor * told + np.diag(np.square([floor_m, floor_m, floor_rad]))
    error = _drawn(rng, true) * np.sqrt((tails - 2.0) / rng.chisquare(tails, 1600))[:, None]
    found = most_likely_spread(error[:800], told[:800])
    assert found.scale == pytest.approx(factor, rel=0.3)
    assert found.floor_m == pytest.approx(floor_m, abs=0.003)
    assert (found.degrees_of_freedom > 12.0) == (tails > 12.0)
    inside = ellipsoid_probability(
        nees(error[800:], found.covariance(told[800:])), np.full(800, found.degrees_of_freedom)
    )
    for level in (0.5, 0.9, 0.95):
        assert (inside <= level).mean() == pytest.approx(level, abs=0.05)
    before = ellipsoid_probability(nees(error, told), np.full(1600, math.inf))
    assert max(abs((before <= level).mean() - level) for level in (0.5, 0.9)) > 0.1


def test_the_wrong_ones_are_flagged_and_as_few_others_as_can_be():
    mass = np.linspace(0.01, 1.0, 100)
    wrong = np.zeros(100, bool)
    wrong[[0, 4]] = True
    least = least_trusted_mass(mass, wrong)
    assert mass[4] < least < mass[5]
    assert least_trusted_mass(mass, np.zeros(100, bool)) < mass[0]
    wrong[60] = True  # cannot be told from those that are right
    assert (mass < least_trusted_mass(mass, wrong)).sum() == 50


def test_a_posterior_is_made_as_sharp_as_the_truths_lie():
    rng = np.random.default_rng(1)
    sigma = np.array([0.05, 0.05, math.radians(1.0)])
    readings = [
        CalibrationPair(posterior=_normal(sigma), theta=SE2.from_array(0.5 * sigma * rng.normal(size=3)))
        for _ in range(300)
    ]
    found = fitted(readings)
    assert found.sharpness == pytest.approx(4.0, rel=0.3)
    assert found.least_mass < 0.95
    distance = np.array([_nees(found, reading) for reading in readings])
    inside = ellipsoid_probability(distance, np.full(300, found.degrees_of_freedom))
    assert (inside <= 0.5).mean() == pytest.approx(0.5, abs=0.06)


def _normal(sigma: Array) -> RefinedPosterior:
    """One normal peak at zero, of 95 % probability."""
    xs, yaws = (np.linspace(-4.0, 4.0, 17) * s for s in (sigma[0], sigma[2]))
    log_p = -0.5 * (
        (yaws / sigma[2])[:, None, None] ** 2 + (xs / sigma[1])[:, None] ** 2 + (xs / sigma[0]) ** 2
    )
    piece = Posterior(headings_rad=yaws, ys_m=xs, xs_m=xs, log_p_HYX=log_p).normalised()
    flat = replace(piece, log_p_HYX=np.zeros_like(log_p)).normalised()
    rest = replace(flat, log_p_HYX=flat.log_p_HYX + math.log(0.05))
    return RefinedPosterior(coarse=flat, pieces=(piece,), masses=np.array([0.95]), rest=rest)


def _nees(calibration: MatcherCalibration, reading: CalibrationPair) -> float:
    best = reading.posterior.sharpened(calibration.sharpness).best()
    error = (best.mean.inverse() @ reading.theta).as_array()
    return float(error @ np.linalg.inv(calibration.covariance(best.covariance)) @ error)


def _window():
    return misplaced(rooms(np.random.default_rng(1)), SE2(0.6, -0.4, 0.2), cells=192, cell_m=0.1)


def test_an_estimator_reads_its_posterior_as_it_is_calibrated():
    torch.manual_seed(0)
    model = Matcher(SMALL).eval()
    calibration = MatcherCalibration(
        sharpness=3.0, scale=0.5, floor_m=0.02, floor_rad=0.01, degrees_of_freedom=5.0, least_mass=0.0
    )
    raw = MatcherEstimator(model=model, peaks=2).posterior(_window())
    read = MatcherEstimator(model=model, peaks=2, calibration=calibration)
    found = read.posterior(_window())
    for mine, theirs in zip(raw.sharpened(3.0).pieces, found.pieces, strict=True):
        np.testing.assert_allclose(mine.log_p_HYX, theirs.log_p_HYX, atol=1e-9)
    estimate, best = read(_window()), found.best()
    assert estimate.covariance is not None
    np.testing.assert_allclose(
        estimate.covariance, 0.5 * best.covariance + np.diag([4e-4, 4e-4, 1e-4]), rtol=1e-9
    )
    assert estimate.degrees_of_freedom == calibration.degrees_of_freedom == 5.0
    assert not estimate.ambiguous
    sure = MatcherCalibration(least_mass=1.0)
    assert MatcherEstimator(model=model, peaks=1, calibration=sure)(_window()).ambiguous


def test_sharpening_leaves_a_prior_as_wide_as_it_is():
    model = Matcher(SMALL).eval()
    with torch.no_grad():  # maps tell nothing
        model.fine_log_scale.fill_(-100.0)
        model.coarse_log_scale.fill_(-100.0)
    prior = Gaussian(mean=SE2(0.1, 0.0, 0.0), covariance=np.diag([0.03**2, 0.04**2, 0.01**2]))
    estimator = MatcherEstimator(
        model=model,
        search=SearchRange(xy_m=1.0, yaw_rad=0.3),
        priors=(prior,),
        calibration=MatcherCalibration(sharpness=8.0),
    )
    found = estimator.posterior(_window()).best()
    np.testing.assert_allclose(np.diag(found.covariance), np.diag(prior.covariance), rtol=0.15)


def test_a_calibration_is_kept_as_numbers():
    calibration = MatcherCalibration(sharpness=2.0, scale=0.3, floor_m=0.004, floor_rad=0.002, least_mass=0.8)
    assert MatcherCalibration.from_dict(calibration.as_dict()) == calibration
    with pytest.raises(ConfigError, match=r"scale is 'wide'; must be like 1\.0"):
        MatcherCalibration.from_dict({**calibration.as_dict(), "scale": "wide"})
    with pytest.raises(ConfigError, match="least_mass"):
        MatcherCalibration.from_dict({**calibration.as_dict(), "least_mass": 1.5})


def test_a_calibrated_covariance_is_scaled_and_has_a_floor_for_each_component():
    told = np.array([[0.04, 0.01, 0.002], [0.01, 0.09, 0.0], [0.002, 0.0, 0.01]])
    calibration = MatcherCalibration(scale=2.0, floor_m=0.3, floor_rad=0.1)
    expected = 2.0 * told + np.diag([0.09, 0.09, 0.01])
    np.testing.assert_allclose(calibration.covariance(np.stack([told, told])), np.stack([expected] * 2))


def test_the_weights_of_witnesses_are_those_by_which_peaks_were_right():
    """Peaks are drawn by known weights: of the network's score, of contradicting walls, of nothing else."""
    rng = np.random.default_rng(2)
    true = np.array([0.5, 0.0, -3.0, 0.0, 0.0])
    readings = []
    for _ in range(600):
        columns = rng.normal(size=(4, 5))
        p = np.exp(columns @ true)
        right = rng.choice(4, p=p / p.sum())
        readings.append(CalibrationPair(posterior=_peaks(columns), theta=SE2(float(right), 0.0, 0.0)))
    found = weights_of_witnesses(readings)
    np.testing.assert_allclose([found.of_network, *found.of_evidence], true, atol=0.4)
    assert weights_of_witnesses([]) == MatcherCalibration()
    wrong = [replace(reading, theta=SE2(9.0, 0.0, 0.0)) for reading in readings]
    assert weights_of_witnesses(wrong) == MatcherCalibration()


def _peaks(columns: Array) -> RefinedPosterior:
    """Narrow peaks a metre apart along x, with these witnesses of each."""
    posterior = _normal(np.array([0.01, 0.01, 0.01]))
    piece = posterior.pieces[0]
    pieces = [replace(piece, xs_m=piece.xs_m + k) for k in range(len(columns))]
    witnesses = Witnesses(
        log_network=columns[:, 0], log_prior=np.zeros(len(columns)), evidence=columns[:, 1:]
    )
    return replace(posterior, pieces=tuple(pieces), masses=np.full(4, 0.2), witnesses=witnesses)


def test_weighing_again_orders_peaks_and_keeps_what_lies_elsewhere():
    columns = np.zeros((4, 5))
    columns[2, 2] = -1.0
    columns[3, 0] = 2.0
    posterior = _peaks(columns)
    posterior = replace(posterior, witnesses=replace(posterior.witnesses, log_prior=np.array([1.0, 0, 0, 0])))
    found = posterior.weighed(1.0, (0.0, 3.0, 0.0, 0.0))
    np.testing.assert_allclose(np.log(found.masses / found.masses[0]), [0.0, -1.0, -2.0, -5.0])
    assert found.masses.sum() == pytest.approx(posterior.masses.sum())
    assert [round(piece.middle().x_m) for piece in found.pieces] == [3, 0, 1, 2]
    assert found.witnesses.evidence[-1, 1] == -1.0


def test_evidence_has_a_weight_for_each_kind():
    with pytest.raises(
        ConfigError, match=r"of_evidence is \[1\.0\]; must be a number .* for each of walls_on"
    ):
        MatcherCalibration(of_evidence=(1.0,))
