"""A graph of poses in the plane, and the poses that fit its motions best although some of them are wrong.

Least squares on SE(2) by Levenberg and Marquardt with sparse normal equations (Grisetti et al., "A tutorial
on graph-based SLAM", 2010). Motions that are only claimed, such as closed loops, have a truncated quadratic
cost, which graduated non-convexity minimises (Yang et al., "Graduated non-convexity for robust spatial
perception", RA-L 2020): first every claim pulls, and what the rest contradicts is let go.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.linalg import SuperLU, splu

from rendezvous.geometry.se2 import Array

MOST_SQUARED = (
    16.27  # a claim this far off, by its own covariance, is false: chance makes one in a thousand so
)
_STEPS = 20  # of Levenberg and Marquardt
_CONVERGED = 1e-4  # of the cost
_GROWTH = 1.6  # of non-convexity from one round to the next
_ROUNDS = 60
_REWEIGHTED, _CAUCHY_SQUARED = 4, 9.0


@dataclass(frozen=True, slots=True, kw_only=True)
class PoseGraph:
    """Poses by number, and motions between them."""

    ends: NDArray[np.int64]  # (E, 2) numbers of the poses a and b
    motions: Array  # (E, 3) x, y [m], yaw [rad] of b as seen from a
    information: Array  # (E, 3, 3) inverse covariance of the motion, in the axes of b as the motion has it
    claimed: NDArray[np.bool_]  # (E,) motions that may be wrong

    def __post_init__(self) -> None:
        edges = len(self.ends)
        assert self.ends.shape == (edges, 2), self.ends.shape
        assert self.motions.shape == (edges, 3), self.motions.shape
        assert self.information.shape == (edges, 3, 3), self.information.shape
        assert self.claimed.shape == (edges,), self.claimed.shape


@dataclass(frozen=True, slots=True, kw_only=True)
class FittedPoses:
    """What a pose graph says."""

    poses: Array  # (N, 3) x, y [m], yaw [rad]; the first is where it was
    weights: Array  # (E,) in [0, 1]: how far each motion was believed; 1 for those that are not claimed

    def kept(self) -> NDArray[np.bool_]:
        """(E,) motions that were believed rather than not."""
        return self.weights > 0.5


def fitted(poses: Array, graph: PoseGraph) -> FittedPoses:
    """Fit poses (N, 3) to a graph, starting from them; the first stays where it is."""
    weights = np.ones(len(graph.ends))
    poses = _least_squares(poses, graph, weights)
    claimed = np.flatnonzero(graph.claimed)
    squared = squared_errors(poses, graph)[claimed]
    if not len(claimed) or squared.max() <= MOST_SQUARED:
        return FittedPoses(poses=poses, weights=weights)
    convexity = MOST_SQUARED / (2.0 * squared.max() - MOST_SQUARED)
    for _ in range(_ROUNDS):
        weights[claimed] = _truncated_weights(squared, convexity)
        poses = _least_squares(poses, graph, weights)
        squared = squared_errors(poses, graph)[claimed]
        if ((weights[claimed] < 1e-6) | (weights[claimed] > 1.0 - 1e-6)).all():
            break
        convexity *= _GROWTH
    weights[claimed] = squared <= MOST_SQUARED
    return FittedPoses(poses=_least_squares(poses, graph, weights), weights=weights)


def leniently_fitted(poses: Array, graph: PoseGraph) -> FittedPoses:
    """Fit poses that are close already: the farther off a claim is, the less it weighs (Cauchy's loss)."""
    weights = np.ones(len(graph.ends))
    for _ in range(_REWEIGHTED):
        poses = _least_squares(poses, graph, weights)
        weights = np.where(graph.claimed, 1.0 / (1.0 + squared_errors(poses, graph) / _CAUCHY_SQUARED), 1.0)
    return FittedPoses(poses=poses, weights=weights)


def squared_errors(poses: Array, graph: PoseGraph) -> Array:
    """(E,) squared distance of each motion from that between the poses, by its information."""
    errors = _errors(poses, graph)
    return np.asarray(np.einsum("ei,eij,ej->e", errors, graph.information, errors))


def _truncated_weights(squared: Array, convexity: float) -> Array:
    """Weights of the surrogate of the truncated quadratic cost (Yang et al., Eq. 14)."""
    low = convexity / (convexity + 1.0) * MOST_SQUARED
    high = (convexity + 1.0) / convexity * MOST_SQUARED
    between = np.sqrt(MOST_SQUARED * convexity * (convexity + 1.0) / np.maximum(squared, 1e-12)) - convexity
    return np.where(squared <= low, 1.0, np.where(squared >= high, 0.0, between))


def _errors(poses: Array, graph: PoseGraph) -> Array:
    """(E, 3) what the motion between the poses is beyond the graph's, in the axes of the latter's end."""
    a, b = poses[graph.ends[:, 0]], poses[graph.ends[:, 1]]
    x, y = _turned(b[:, :2] - a[:, :2], -a[:, 2])
    x, y = _turned(np.column_stack([x, y]) - graph.motions[:, :2], -graph.motions[:, 2])
    yaw = np.remainder(b[:, 2] - a[:, 2] - graph.motions[:, 2] + np.pi, 2.0 * np.pi) - np.pi
    return np.column_stack([x, y, yaw])


def _turned(p: Array, yaw: Array) -> tuple[Array, Array]:
    c, s = np.cos(yaw), np.sin(yaw)
    return c * p[:, 0] - s * p[:, 1], s * p[:, 0] + c * p[:, 1]


def _jacobians(poses: Array, graph: PoseGraph) -> tuple[Array, Array]:
    """(E, 3, 3) derivatives of the errors by the poses a and b, in the world's axes."""
    a, b = poses[graph.ends[:, 0]], poses[graph.ends[:, 1]]
    turn = a[:, 2] + graph.motions[:, 2]
    c, s = np.cos(turn), np.sin(turn)
    by_b = np.zeros((len(a), 3, 3))
    by_b[:, 0, 0], by_b[:, 0, 1] = c, s
    by_b[:, 1, 0], by_b[:, 1, 1] = -s, c
    by_b[:, 2, 2] = 1.0
    by_a = -by_b
    dx, dy = (b - a)[:, :2].T
    by_a[:, 0, 2] = -s * dx + c * dy
    by_a[:, 1, 2] = -c * dx - s * dy
    return by_a, by_b


def _normal_equations(poses: Array, graph: PoseGraph, weights: Array) -> tuple[sparse.csc_matrix, Array]:
    """The equations of all poses; the first is held by a strong prior."""
    errors = _errors(poses, graph)
    information = weights[:, None, None] * graph.information
    jacobians = _jacobians(poses, graph)
    blocks, rows, columns = [], [], []
    gradient = np.zeros((len(poses), 3))
    axis = np.arange(3)
    for i, J_i in enumerate(jacobians):
        weighted = np.einsum("eki,ekl->eil", J_i, information)
        np.add.at(gradient, graph.ends[:, i], np.einsum("eil,el->ei", weighted, errors))
        for j, J_j in enumerate(jacobians):
            blocks.append(np.einsum("eil,elj->eij", weighted, J_j).ravel())
            at_i, at_j = 3 * graph.ends[:, i], 3 * graph.ends[:, j]
            rows.append(np.broadcast_to((at_i[:, None] + axis)[:, :, None], (len(at_i), 3, 3)).ravel())
            columns.append(np.broadcast_to((at_j[:, None] + axis)[:, None, :], (len(at_j), 3, 3)).ravel())
    blocks.append(np.full(3, 1e9))
    rows.append(axis)
    columns.append(axis)
    size = 3 * len(poses)
    H = sparse.coo_matrix(
        (np.concatenate(blocks), (np.concatenate(rows), np.concatenate(columns))), shape=(size, size)
    )
    return H.tocsc(), gradient.ravel()


def _factor(H: sparse.csc_matrix) -> SuperLU:
    return splu(H, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})


def _least_squares(poses: Array, graph: PoseGraph, weights: Array) -> Array:
    """Levenberg and Marquardt from these poses, with weighted motions."""

    def cost_at(tried: Array) -> float:
        return float(weights @ squared_errors(tried, graph))

    cost, damping = cost_at(poses), 1e-6
    for _ in range(_STEPS):
        H, gradient = _normal_equations(poses, graph, weights)
        diagonal = H.diagonal()
        improved = False
        while damping < 1e6:
            step = _factor(H + sparse.diags(damping * diagonal, format="csc")).solve(gradient)
            tried = poses - step.reshape(-1, 3)
            tried_cost = cost_at(tried)
            if tried_cost <= cost:
                improved = True
                break
            damping *= 10.0
        if not improved:
            break
        gain, poses, cost = cost - tried_cost, tried, tried_cost
        damping = max(0.1 * damping, 1e-9)
        if gain <= _CONVERGED * (cost + 1e-9):
            break
    return poses


class Marginals:
    """Covariances of the motions between fitted poses."""

    def __init__(self, fit: FittedPoses, graph: PoseGraph) -> None:
        self._poses = fit.poses
        H, _ = _normal_equations(fit.poses, graph, fit.weights)
        self._factor = _factor(H)

    def covariance(self, a: int, b: int) -> Array:
        """(3, 3) covariance of the pose of b as seen from a, in the axes of b."""
        size = 3 * len(self._poses)
        at = [3 * a, 3 * a + 1, 3 * a + 2, 3 * b, 3 * b + 1, 3 * b + 2]
        unit = np.zeros((size, 6))
        unit[at, np.arange(6)] = 1.0
        joint = self._factor.solve(unit)[at]
        pair = PoseGraph(
            ends=np.array([[a, b]]),
            motions=_between(self._poses[a], self._poses[b])[None],
            information=np.eye(3)[None],
            claimed=np.zeros(1, np.bool_),
        )
        J = np.concatenate([block[0] for block in _jacobians(self._poses, pair)], axis=1)
        return np.asarray(J @ joint @ J.T)


def _between(a: Array, b: Array) -> Array:
    c, s = np.cos(a[2]), np.sin(a[2])
    dx, dy = b[0] - a[0], b[1] - a[1]
    return np.array([c * dx + s * dy, -s * dx + c * dy, b[2] - a[2]])
