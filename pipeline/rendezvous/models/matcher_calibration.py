"""Calibrates a matcher's confidence to its errors, on validation pairs.

The network sums over cells, and so prefers a large overlap to a true one: how much each peak's agreement
counts beside the network's score is fitted first, as in a conditional logit (McFadden, 1974) of the right
peak among all. A matcher is trained on maps with many defects, and is underconfident on maps without: its
posterior is sharpened. A label is exact where the robots meet; away from there maps drift, now and then by
much, which no window shows: covariances get a floor, and errors are modelled by a Student's t distribution.
Estimates are called ambiguous below a probability that depends on the wrong ones among the pairs.

Legend: P pair.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import minimize

from rendezvous.alignment.estimate import WRONG_M, WRONG_RAD
from rendezvous.alignment.evidence import EVIDENCE
from rendezvous.alignment.frame_error import log_density, pose_difference
from rendezvous.errors import ConfigError, require_within
from rendezvous.geometry.occupancy_grid import Mask
from rendezvous.geometry.se2 import SE2, Array
from rendezvous.models.config import Config
from rendezvous.models.posterior import Posterior, RefinedPosterior, log_sum_exp

SHARPNESSES = tuple(float(s) for s in np.geomspace(0.5, 8.0, 17))  # the values that are tried
_LIMITS = np.array([[1e-3, 1e3], [1e-5, 1.0], [1e-5, 1.0], [0.1, 1e3]])
_FIRST_GUESS = (0.5, 0.005, 0.003, 3.0)
"""Scale, floor of x and y [m], floor of yaw [rad], degrees of freedom above 2."""
RIGHT_M, RIGHT_RAD = 0.3, math.radians(3.0)  # errors of a right peak are at most these
PULL = 1e-3  # of the weights of witnesses towards zero
WRONG_SHARE, FLAGGED_SHARE = 0.01, 0.5
"""At most this share of the estimates that are not flagged may be wrong, and at most this share may be
flagged."""


@dataclass(frozen=True, slots=True, kw_only=True)
class MatcherCalibration(Config):
    """How to read a matcher's posterior."""

    of_network: float = 0.5  # exponent of the probability that the network gives each peak
    of_evidence: tuple[float, ...] = (2.0, -4.0, 0.0, -1.0)  # log odds of a peak for a unit of each evidence
    sharpness: float = 1.0  # exponent of the density around each peak, whose mass stays
    scale: float = 1.0  # factor of the resulting covariance
    # floor_m, floor_rad: standard deviations added to it, of x and y and of yaw.
    floor_m: float = 0.0
    floor_rad: float = 0.0
    degrees_of_freedom: float = 1000.0  # of the Student's t distribution with this covariance; more than 2
    least_mass: float = 0.9  # an estimate is ambiguous if its peak has less probability than this

    def __post_init__(self) -> None:
        require_within(
            self, sharpness=(0.01, 100.0), scale=(0.001, 1000.0), floor_m=(0.0, 10.0), floor_rad=(0.0, 3.2),
            degrees_of_freedom=(2.01, 1e6), least_mass=(0.0, 1.0), of_network=(0.0, 100.0),
        )  # fmt: skip
        if len(self.of_evidence) != len(EVIDENCE) or not all(abs(w) <= 1e3 for w in self.of_evidence):
            raise ConfigError(
                f"MatcherCalibration: of_evidence is {list(self.of_evidence)}; must be a number from -1000 "
                f"to 1000 for each of {', '.join(EVIDENCE)}"
            )

    def covariance(self, covariance: Array) -> Array:
        """(..., 3, 3) calibrated covariance for the posterior's own."""
        return self.scale * covariance + np.diag(np.square([self.floor_m, self.floor_m, self.floor_rad]))


@dataclass(frozen=True, slots=True, kw_only=True)
class CalibrationPair:
    """A validation pair: the uncalibrated posterior, and the true frame error."""

    posterior: RefinedPosterior
    theta: SE2
    like_real: bool = False  # its maps were given the defects of real ones


def fitted(readings: Sequence[CalibrationPair]) -> MatcherCalibration:
    """The calibration that fits best.

    First the weights of what speaks for each peak; then the threshold of ambiguity; then, on the pairs above
    it, by likelihood of the truth, the sharpness of the density and the spread of the errors: of those with
    maps like real ones, if there are any.
    """
    plain = [reading for reading in readings if not reading.like_real] or readings
    weights = weights_of_witnesses(plain)
    plain, like_real = (
        [
            replace(reading, posterior=reading.posterior.weighed(weights.of_network, weights.of_evidence))
            if reading.posterior.witnesses is not None
            else reading
            for reading in some
        ]
        for some in (plain, [reading for reading in readings if reading.like_real])
    )
    mass_P = np.array([reading.posterior.masses[0] for reading in plain])
    error_P3 = np.array([_error(reading.posterior, reading.theta) for reading in plain])
    wrong_P = (np.hypot(error_P3[:, 0], error_P3[:, 1]) > WRONG_M) | (np.abs(error_P3[:, 2]) > WRONG_RAD)
    least_mass = least_trusted_mass(mass_P, wrong_P)
    sure = [reading for reading in like_real or plain if reading.posterior.masses[0] >= least_mass]
    if not sure:
        return replace(weights, least_mass=least_mass)
    likelihoods = [
        np.mean([reading.posterior.sharpened(s).log_density(reading.theta) for reading in sure])
        for s in SHARPNESSES
    ]
    sharpness = SHARPNESSES[int(np.argmax(likelihoods))]
    sharp = [reading.posterior.sharpened(sharpness) for reading in sure]
    error_P3 = np.array([_error(one, reading.theta) for one, reading in zip(sharp, sure, strict=True)])
    spread = most_likely_spread(error_P3, np.array([one.best().covariance for one in sharp]))
    return replace(
        spread,
        of_network=weights.of_network,
        of_evidence=weights.of_evidence,
        sharpness=sharpness,
        least_mass=least_mass,
    )


def weights_of_witnesses(readings: Sequence[CalibrationPair]) -> MatcherCalibration:
    """The weights under which the right peaks are most likely, with a slight pull towards none.

    Pairs none of whose peaks is right say nothing; without any that does, the weights are the default ones.
    """
    choices = []
    for reading in readings:
        witnesses = reading.posterior.witnesses
        errors = [np.abs(_error_of(piece, reading.theta)) for piece in reading.posterior.pieces]
        right = [bool(np.hypot(*e[:2]) <= RIGHT_M and e[2] <= RIGHT_RAD) for e in errors]
        if witnesses is not None and any(right) and len(right) > 1:
            columns = np.column_stack([witnesses.log_network, witnesses.evidence])
            choices.append((columns - columns.mean(axis=0), right.index(True)))
    if not choices:
        return MatcherCalibration()
    scale = np.concatenate([columns for columns, _ in choices]).std(axis=0) + 1e-9
    choices = [(columns / scale, right) for columns, right in choices]

    def cost(weights: Array) -> tuple[float, Array]:
        total, gradient = PULL * float(weights @ weights), 2.0 * PULL * weights
        for columns, right in choices:
            log_p = columns @ weights
            log_p = log_p - log_sum_exp(log_p)
            total -= float(log_p[right]) / len(choices)
            gradient = gradient - (columns[right] - np.exp(log_p) @ columns) / len(choices)
        return total, gradient

    network, *evidence = (minimize(cost, np.zeros(len(scale)), jac=True, method="BFGS").x / scale).tolist()
    return MatcherCalibration(of_network=max(0.0, network), of_evidence=tuple(evidence))


def least_trusted_mass(mass_P: Array, wrong_P: Mask) -> float:
    """Least probability of a trusted peak: flags as few pairs as possible, but enough of the wrong ones.

    If the wrong ones cannot be separated without flagging too many, as many are flagged as allowed.
    """
    order = np.argsort(mass_P)
    count = len(order)
    wrong_left = np.append(np.cumsum(wrong_P[order][::-1])[::-1], 0)
    share = wrong_left[:count] / np.arange(count, 0, -1)
    most = int(FLAGGED_SHARE * count)
    flagged = next((k for k in range(most + 1) if share[k] <= WRONG_SHARE), most)
    if flagged == 0:
        return float(0.5 * mass_P[order[0]])
    return float(0.5 * (mass_P[order[flagged - 1]] + mass_P[order[flagged]]))


def most_likely_spread(error_P3: Array, covariance_P33: Array) -> MatcherCalibration:
    """The scale, floors and degrees of freedom under which the errors are most likely."""

    def calibration(logs: Array) -> MatcherCalibration:
        scale, floor_m, floor_rad, tails = np.exp(np.clip(logs, *np.log(_LIMITS).T))
        return MatcherCalibration(
            scale=float(scale),
            floor_m=float(floor_m),
            floor_rad=float(floor_rad),
            degrees_of_freedom=2.0 + float(tails),
        )

    def cost(logs: Array) -> float:
        found = calibration(logs)
        tails_P = np.full(len(error_P3), found.degrees_of_freedom)
        return -float(log_density(error_P3, found.covariance(covariance_P33), tails_P).mean())

    options = {"xatol": 1e-3, "fatol": 1e-5, "maxiter": 2000}
    return calibration(minimize(cost, np.log(_FIRST_GUESS), method="Nelder-Mead", options=options).x)


def _error(posterior: RefinedPosterior, theta: SE2) -> Array:
    return _error_of(posterior.pieces[0], theta)


def _error_of(piece: Posterior, theta: SE2) -> Array:
    return pose_difference(piece.middle_of_mass().mean, theta).as_array()
