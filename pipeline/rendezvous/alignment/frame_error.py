"""The frame error: the rigid motion by which an estimated map transform is wrong (Kim, Han & Zhang, 2023).

The paper's Eq. 2 chains three poses into T̃, and its Eq. 3 corrects T̃ by `θ_error⁻¹`. There the error turns
about the origin of m0, so that a small error in heading moves a distant meeting point by metres. Here it is
conjugated to the window frame v at the meeting point: `θ_v = T_m0_v⁻¹ (T̃ T⁻¹) T_m0_v`. Seen from v, map 1 as
the estimate places it is θ_v applied to map 1 as it should lie. (The letter w is the floor plan's frame.)

Errors are judged against the spread that a method claims: a covariance, of a normal or a Student's t
distribution. A t distribution with few degrees of freedom has heavy tails: most errors are small, some
several times as large. Its covariance here is its second moment, as for any distribution, not its scale
matrix (which is (ν - 2) / ν of it), so that it can be used as it is by whoever ignores tails.
"""

from __future__ import annotations

import math

import numpy as np
from scipy.special import chdtr, fdtr, gammaln  # scipy.stats takes half a second to import

from rendezvous.geometry.se2 import SE2, Array


def initial_alignment(T_m0_r0: SE2, T_r0_r1: SE2, T_m1_r1: SE2) -> SE2:
    """T̃, the pose of map 1 in map 0 according to robot 0's sighting of robot 1 (Eq. 2)."""
    return (T_m0_r0 @ T_r0_r1 @ T_m1_r1.inverse()).wrapped()


def meeting_point(T_m0_m1: SE2, T_m1_r1: SE2) -> SE2:
    """The window's centre: where an estimate puts robot 1 in map 0, with the axes of m0 (yaw 0)."""
    T_m0_r1 = T_m0_m1 @ T_m1_r1
    return SE2(T_m0_r1.x_m, T_m0_r1.y_m, 0.0)


def frame_error(T_estimated: SE2, T_true: SE2, T_m0_v: SE2) -> SE2:
    """θ_v: the error of an estimated `T_m0_m1`, seen from the window frame v."""
    return (T_m0_v.inverse() @ T_estimated @ T_true.inverse() @ T_m0_v).wrapped()


def corrected(T_estimated: SE2, theta_v: SE2, T_m0_v: SE2) -> SE2:
    """T̂ = T_m0_v θ_v⁻¹ T_m0_v⁻¹ T̃, the estimated `T_m0_m1` without its frame error (Eq. 3)."""
    return (T_m0_v @ theta_v.inverse() @ T_m0_v.inverse() @ T_estimated).wrapped()


def perturbed(T_true: SE2, T_m0_r1: SE2, theta: SE2) -> tuple[SE2, SE2]:
    """T̃ and its meeting point such that T̃'s frame error there is theta.

    The centre must be where T̃, not the truth, puts robot 1: with P the true meeting point, `C = P + R_ψ⁻¹
    t`.

    θ = (t, ψ) is at C, in the axes of m0; of the true pose of robot 1 in map 0 only the position P matters.
    """
    back = SE2(0.0, 0.0, -theta.yaw_rad) @ np.array([theta.x_m, theta.y_m])
    T_m0_v = SE2(T_m0_r1.x_m + float(back[0]), T_m0_r1.y_m + float(back[1]), 0.0)
    return (T_m0_v @ theta @ T_m0_v.inverse() @ T_true).wrapped(), T_m0_v


def pose_difference(theta_hat: SE2, theta: SE2) -> SE2:
    """θ̂⁻¹ θ with yaw in (-pi, pi]; its components are the error that every method reports."""
    return (theta_hat.inverse() @ theta).wrapped()


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
    """(N,) probability of the smallest ellipsoid around each error; uniform on [0, 1] for a true spread."""
    normal = np.isinf(degrees_of_freedom_N)
    nu = np.where(normal, 3.0, degrees_of_freedom_N)
    heavy = fdtr(_COMPONENTS, nu, nees_N / _COMPONENTS * nu / (nu - 2.0))
    return np.where(normal, chdtr(_COMPONENTS, nees_N), heavy)


def log_density(error: Array, covariance: Array, degrees_of_freedom_N: Array) -> Array:
    """(N,) log density [1 / (m² rad)] of errors (N, 3), x [m], y [m], yaw [rad]; -inf where Σ is singular."""
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
