"""Refines rough poses to the nearest maximum of the posterior: least squares, robust by mixtures of peaks.

Each iteration divides a point among the peaks of its map and `elsewhere` (expectation), then moves the states
towards those peaks by one Levenberg-Marquardt step (maximisation). Outlying peaks get no share and do not
pull.

Legend: M states of an `ObservationModel`, G belief maps, J peaks of a map.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rendezvous.geometry.se2 import Array
from rendezvous.pose_estimation.keypoint_evidence import KeypointEvidence
from rendezvous.pose_estimation.observation_model import HEIGHT_SIGMA_M, TILT_SIGMA_RAD, ObservationModel

_WIDENINGS_CELLS = (1.5, 1.5, 1.0, 0.7, 0.4, 0.2, 0.1, 0.05) + (0.0,) * 5
"""Standard deviations added to the peaks' own, one per iteration: wide peaks attract from afar."""
_ANY_HEIGHT_M, _ANY_TILT_RAD = 10.0, 10.0


@dataclass(frozen=True, slots=True, kw_only=True)
class RefinedStates:
    """Maxima of the posterior; see `cuboid_pose.Reading`."""

    states_M6: Array  # (M, 6) the states
    covariance_M66: Array  # (M, 6, 6) their covariances
    log_evidence_M: Array  # (M,) log of the probability mass around each, up to a shared constant
    explained_M: Array  # (M,) weight of the peaks that agree with it, mean over the maps, in [0, 1]
    gain_M: Array  # (M,) log likelihood ratio to an image without a robot


def lean_precision(*, floor: bool) -> Array:
    """(6,) precision of the prior on a state; nearly 0 for height and tilt if the floor is not used."""
    height, tilt = (HEIGHT_SIGMA_M, TILT_SIGMA_RAD) if floor else (_ANY_HEIGHT_M, _ANY_TILT_RAD)
    precision: Array = np.array([0.0, 0.0, 0.0, height, tilt, tilt])
    precision[3:] **= -2.0
    return precision


def refine(
    model: ObservationModel, evidence: KeypointEvidence, states_M6: Array, *, floor: bool
) -> RefinedStates:
    """The maxima of the posterior nearest to the given states.

    Args:
        model: camera and robot.
        evidence: evidence from the image.
        states_M6: (M, 6) where to start.
        floor: whether both robots stand on one level floor, within the model's tolerances.
    """
    prior_6 = lean_precision(floor=floor)
    states, damping = states_M6.copy(), np.full(len(states_M6), 1e-3)
    for widening in _WIDENINGS_CELLS:
        added_px2 = (widening * evidence.cell_px) ** 2
        cost = _cost(model, evidence, states, prior_6, added_px2)
        A, b, _ = _normal_equations(model, evidence, states, prior_6, added_px2)
        scaled = A + (damping[:, None] * np.einsum("mii->mi", A))[:, None] * np.eye(6)
        moved = states + np.linalg.solve(scaled, b[..., None])[..., 0]
        better = _cost(model, evidence, moved, prior_6, added_px2) <= cost
        states = np.where(better[:, None], moved, states)
        damping = np.where(better, np.maximum(0.2 * damping, 1e-9), 10.0 * damping)
    A, _, share = _normal_equations(model, evidence, states, prior_6, 0.0)
    covariance = np.linalg.inv(A).astype(np.float64)
    log_det = np.linalg.slogdet(covariance)[1]
    return RefinedStates(
        states_M6=states,
        covariance_M66=covariance,
        log_evidence_M=0.5 * log_det - _cost(model, evidence, states, prior_6, 0.0),
        gain_M=evidence.log_likelihood(model.project(states)),
        explained_M=(share * evidence.weight_GJ).sum(axis=2).mean(axis=1),
    )


def _cost(
    model: ObservationModel, evidence: KeypointEvidence, states: Array, prior_6: Array, added_px2: float
) -> Array:
    """(M,) negative log posterior, up to a constant."""
    likelihood = evidence.log_likelihood(model.project(states), added_px2=added_px2)
    cost: Array = 0.5 * (prior_6 * states**2).sum(axis=1) - likelihood
    return cost


def _normal_equations(
    model: ObservationModel, evidence: KeypointEvidence, states: Array, prior_6: Array, added_px2: float
) -> tuple[Array, Array, Array]:
    """(M, 6, 6) and (M, 6) normal equations of a step, and (M, G, J) the peaks' shares."""
    uv, J = model.project(states), model.jacobian(states)
    _, share = evidence.log_densities(uv, added_px2=added_px2)
    precision = evidence.power * share / (evidence.variance_px2_GJ + added_px2)
    pull = np.einsum("mgj,mgjd->mgd", precision, evidence.uv_px_GJ2 - uv[:, evidence.channel_G, None])
    weight_M9, pull_M92 = np.zeros(uv.shape[:2]), np.zeros(uv.shape)
    for own in np.arange(len(evidence.channel_G)).reshape(-1, 9):
        weight_M9 += precision[:, own].sum(axis=2)
        pull_M92 += pull[:, own]
    A = np.einsum("mk,mkdi,mkdj->mij", weight_M9, J, J) + np.diag(prior_6) + 1e-6 * np.eye(6)
    b = np.einsum("mkdi,mkd->mi", J, pull_M92) - prior_6 * states
    return A, b, share
