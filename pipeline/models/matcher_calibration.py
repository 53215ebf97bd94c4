"""What makes a matcher's confidence agree with its errors, fitted on validation pairs.

A matcher is trained on maps with many defects, and is too modest about those without. Its posterior is made
sharper, its covariances are scaled and given a floor (where a label is exact to a centimetre, no estimate can
be seen to be better), and estimates are called ambiguous below a probability that is drawn from the pairs.

Legend: P pair, S scale, G pair of floors.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from itertools import product
from typing import Any

import numpy as np
from scipy.stats import chi2

from pipeline.alignment.frame_error import pose_difference
from pipeline.errors import ConfigError, require_within
from pipeline.geometry.occupancy_grid import Mask
from pipeline.geometry.se2 import SE2, Array
from pipeline.models.refined_posterior import RefinedPosterior

SHARPNESSES = tuple(float(s) for s in np.geomspace(0.5, 8.0, 17))
SCALES = tuple(float(s) for s in np.geomspace(0.05, 5.0, 21))
FLOORS_M = tuple(float(m) for m in np.arange(0.0, 0.0301, 0.002))
FLOORS_RAD = tuple(float(rad) for rad in np.radians(np.arange(0.0, 0.81, 0.05)))
"""What is tried."""

LEVELS = (0.3, 0.5, 0.7, 0.8, 0.9, 0.95)
"""Probabilities of the ellipsoids whose coverage shall be right."""
SLACK = 0.01
"""Settings whose worst coverage is this near to the best are told apart by likelihood."""
WRONG_M, WRONG_RAD = 0.5, float(np.radians(5.0))
"""An estimate farther from the truth than either is wrong."""
WRONG_SHARE, FLAGGED_SHARE = 0.005, 0.13
"""Of estimates that are not flagged, no more shall be wrong; but of all, no more shall be flagged."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Calibration:
    """How to read a matcher's posterior.

    Attributes:
        sharpness: exponent of the density around each peak, its mass untouched.
        scale: factor of the covariance that then comes out.
        floor_m, floor_rad: standard deviations that are added to it, of x and y and of yaw.
        least_mass: an estimate is ambiguous where its peak has less probability than this.
    """

    sharpness: float = 1.0
    scale: float = 1.0
    floor_m: float = 0.0
    floor_rad: float = 0.0
    least_mass: float = 0.9

    def __post_init__(self) -> None:
        require_within(
            self,
            sharpness=(0.01, 100.0),
            scale=(0.001, 1000.0),
            floor_m=(0.0, 10.0),
            floor_rad=(0.0, 3.2),
            least_mass=(0.0, 1.0),
        )

    def covariance(self, covariance: Array) -> Array:
        """(..., 3, 3): what the posterior's stand for."""
        return self.scale * covariance + np.diag(np.square([self.floor_m, self.floor_m, self.floor_rad]))

    def as_dict(self) -> dict[str, float]:
        """Values by field, for the weights' JSON."""
        return asdict(self)

    @staticmethod
    def from_dict(values: Mapping[str, Any]) -> Calibration:
        """Inverse of `as_dict`.

        Raises:
            ConfigError: a field is missing or unknown, or a value has no use.
        """
        expected = {field.name for field in fields(Calibration)}
        if values.keys() != expected or not all(isinstance(v, int | float) for v in values.values()):
            raise ConfigError(
                f"matcher: calibration holds {dict(values)}; must hold numbers {sorted(expected)}"
            )
        return Calibration(**values)


@dataclass(frozen=True, slots=True, kw_only=True)
class Reading:
    """A validation pair: its posterior as the matcher's scores have it, and the true frame error."""

    posterior: RefinedPosterior
    theta: SE2


def fitted(readings: Sequence[Reading]) -> Calibration:
    """The calibration that fits best.

    Sharpness by likelihood of the truth, scale and floors by coverage, both over the pairs that are not
    ambiguous; before that, which ones are.
    """
    mass_P = np.array([reading.posterior.masses[0] for reading in readings])
    error_P3 = np.array([_error(reading.posterior, reading.theta) for reading in readings])
    least_mass = least_trusted_mass(mass_P, _wrong(error_P3))
    sure = [reading for reading, mass in zip(readings, mass_P, strict=True) if mass >= least_mass]
    if not sure:
        return Calibration(least_mass=least_mass)
    likelihoods = [
        np.mean([reading.posterior.sharpened(s).log_density(reading.theta) for reading in sure])
        for s in SHARPNESSES
    ]
    sharpness = SHARPNESSES[int(np.argmax(likelihoods))]
    sharp = [reading.posterior.sharpened(sharpness) for reading in sure]
    error_P3 = np.array([_error(one, reading.theta) for one, reading in zip(sharp, sure, strict=True)])
    scale, floor_m, floor_rad = best_covered(error_P3, np.array([one.best().covariance for one in sharp]))
    return Calibration(
        sharpness=sharpness, scale=scale, floor_m=floor_m, floor_rad=floor_rad, least_mass=least_mass
    )


def least_trusted_mass(mass_P: Array, wrong_P: Mask) -> float:
    """The least probability of a peak to be trusted: as few as can be are flagged, enough of the wrong ones.

    Where the wrong ones cannot be told without flagging too many, as many are flagged as may be.
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


def best_covered(error_P3: Array, covariance_P33: Array) -> tuple[float, float, float]:
    """Scale of the covariances, and floors of x, y [m] and yaw [rad], under which ellipsoids cover best.

    Args:
        error_P3: x [m], y [m], yaw [rad] of θ̂⁻¹ θ.
        covariance_P33: that the matcher gave them.
    """
    reach = chi2.ppf(LEVELS, 3)
    scales_S = np.array(SCALES)[:, None, None, None]
    deviation_GS, likelihood_GS, grid = [], [], list(product(FLOORS_M, FLOORS_RAD))
    for floor_m, floor_rad in grid:
        floor = Calibration(floor_m=floor_m, floor_rad=floor_rad).covariance(np.zeros((3, 3)))
        covariance = scales_S * covariance_P33 + floor
        solved = np.linalg.solve(covariance, error_P3[..., None])[..., 0]
        nees_SP = np.einsum("spi,pi->sp", solved, error_P3)
        coverage = (nees_SP[..., None] <= reach).mean(axis=1)
        deviation_GS.append(np.abs(coverage - LEVELS).max(axis=1))
        # Errors far outside say nothing of the width that the others want.
        log_density = -0.5 * (np.minimum(nees_SP, reach[-1]) + np.linalg.slogdet(covariance)[1])
        likelihood_GS.append(log_density.mean(axis=1))
    deviation, likelihood = np.array(deviation_GS), np.array(likelihood_GS)
    near = deviation <= deviation.min() + SLACK
    best, scale = np.unravel_index(int(np.where(near, likelihood, -np.inf).argmax()), near.shape)
    return SCALES[int(scale)], *grid[int(best)]


def _error(posterior: RefinedPosterior, theta: SE2) -> Array:
    return pose_difference(posterior.best().mean, theta).as_array()


def _wrong(error_P3: Array) -> Mask:
    return (np.hypot(error_P3[:, 0], error_P3[:, 1]) > WRONG_M) | (np.abs(error_P3[:, 2]) > WRONG_RAD)
