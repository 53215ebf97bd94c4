"""Errors against the spread that a method claims: a covariance, of a normal or a Student's t distribution.

A t distribution with few degrees of freedom has heavy tails: most errors are small, some several times as
large. Its covariance here is its second moment, as for any distribution, not its scale matrix (which is
(ν - 2) / ν of it), so that the covariance can be used as it is by whoever ignores tails.
"""

from __future__ import annotations

import math

import numpy as np
from scipy.special import chdtr, fdtr, gammaln  # scipy.stats takes half a second to import

from rendezvous.geometry.se2 import Array

_COMPONENTS = 3


def nees(error: Array, covariance: Array) -> Array:
    """(N,) normalised estimation error squared, dᵀ Σ⁻¹ d, of errors (N, 3); 3 on average if Σ is right.

    NaN where the covariance (N, 3, 3) is; infinite where it is singular.
    """
    out = np.full(len(error), np.nan)
    known = np.flatnonzero(np.isfinite(covariance).all(axis=(1, 2)))
    singular = np.linalg.det(covariance[known]) <= 0.0
    out[known[singular]] = np.inf
    good = known[~singular]
    solved = np.linalg.solve(covariance[good], error[good][..., None])[..., 0]
    out[good] = np.einsum("ni,ni->n", error[good], solved)
    return out


def ellipsoid_probability(nees_N: Array, degrees_of_freedom_N: Array) -> Array:
    """(N,) probability of the smallest ellipsoid around each error; uniform on [0, 1] if the spread is right.

    Args:
        nees_N: of the errors.
        degrees_of_freedom_N: of the t distributions, more than 2; infinite for normal ones.
    """
    normal = np.isinf(degrees_of_freedom_N)
    nu = np.where(normal, 3.0, degrees_of_freedom_N)
    heavy = fdtr(_COMPONENTS, nu, nees_N / _COMPONENTS * nu / (nu - 2.0))
    return np.where(normal, chdtr(_COMPONENTS, nees_N), heavy)


def log_density(error: Array, covariance: Array, degrees_of_freedom_N: Array) -> Array:
    """(N,) log density [1 / (m² rad)] of errors (N, 3), x [m], y [m], yaw [rad]; -inf where Σ is singular.

    Args:
        error, covariance: as for `nees`.
        degrees_of_freedom_N: as for `ellipsoid_probability`.
    """
    distance = nees(error, covariance)
    _, log_det = np.linalg.slogdet(np.where(np.isfinite(distance)[:, None, None], covariance, np.eye(3)))
    normal = np.isinf(degrees_of_freedom_N)
    nu, d = np.where(normal, 3.0, degrees_of_freedom_N), _COMPONENTS
    heavy = (
        gammaln((nu + d) / 2.0)
        - gammaln(nu / 2.0)
        - 0.5 * d * np.log((nu - 2.0) * math.pi)
        - 0.5 * (nu + d) * np.log1p(distance / (nu - 2.0))
    )
    return np.where(normal, -0.5 * (distance + d * math.log(2.0 * math.pi)), heavy) - 0.5 * log_det
