"""Pose graphs: closed rings, false loops, covariances."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.optimize import least_squares

from rendezvous.geometry.se2 import Array
from rendezvous.slam.pose_graph import (
    FittedPoses,
    Marginals,
    PoseGraph,
    fitted,
    leniently_fitted,
    squared_errors,
)
from rendezvous.slam.slam import compose, relative

SIGMA = np.array([0.03, 0.03, 0.005])
STEPS = 60


def ring(radius_m: float = 8.0) -> Array:
    """(N, 3) once around and a little farther."""
    at = np.linspace(0.0, 2.2 * np.pi, STEPS)
    return np.column_stack([radius_m * np.sin(at), radius_m * (1.0 - np.cos(at)), at])


def driven(
    poses: Array, loops: list[tuple[int, int]], seed: int, false: dict[int, Array] | None = None
) -> tuple[Array, PoseGraph]:
    """The path that noisy odometry sees, and the graph with loops; `false` moves some of them."""
    rng = np.random.default_rng(seed)
    ends = [(i, i + 1) for i in range(len(poses) - 1)] + loops
    motions = np.array([relative(poses[a], poses[b]) for a, b in ends])
    steps = len(poses) - 1
    motions[:steps] += SIGMA * rng.standard_normal((steps, 3))
    motions[steps:] += 0.2 * SIGMA * rng.standard_normal((len(loops), 3))
    for number, off in (false or {}).items():
        motions[steps + number] = compose(motions[steps + number], off)
    information = np.array(
        [np.diag(SIGMA**-2)] * steps + [np.diag((0.2 * SIGMA) ** -2)] * len(loops)
    ).reshape(-1, 3, 3)
    path = [poses[0]]
    for motion in motions[:steps]:
        path.append(compose(path[-1], motion))
    graph = PoseGraph(
        ends=np.array(ends),
        motions=motions,
        information=information,
        claimed=np.arange(len(ends)) >= steps,
    )
    return np.array(path), graph


LOOPS = [(0, 55), (1, 56), (2, 57), (3, 58), (4, 59)]


@pytest.mark.parametrize("seed", range(5))
def test_a_ring_of_noisy_odometry_closes(seed: int) -> None:
    true = ring()
    path, graph = driven(true, LOOPS, seed)
    fit = fitted(path, graph)
    assert fit.kept().all()
    before, after = (np.hypot(*(p - true)[:, :2].T) for p in (path, fit.poses))
    gap = relative(fit.poses[0], fit.poses[55]) - relative(true[0], true[55])
    assert np.hypot(gap[0], gap[1]) < 0.03
    assert after.max() < 0.7 * before.max()
    assert_allclose(fit.poses[0], path[0], atol=1e-6)


@pytest.mark.parametrize("seed", range(5))
def test_false_loops_are_rejected_and_the_true_ones_kept(seed: int) -> None:
    false = {5: np.array([2.0, -1.0, 0.3]), 6: np.array([0.0, 3.0, -0.2]), 7: np.array([-2.5, 0.0, 1.5])}
    loops = [*LOOPS, (10, 40), (20, 59), (5, 30)]
    path, graph = driven(ring(), loops, seed, false)
    fit = fitted(path, graph)
    assert fit.kept()[graph.claimed].tolist() == [True] * 5 + [False] * 3
    clean = fitted(*driven(ring(), LOOPS, seed))
    assert np.abs(fit.poses - clean.poses).max() < 0.1


def test_the_fit_is_that_of_another_solver() -> None:
    path, graph = driven(ring(), LOOPS, 3)
    roots = np.linalg.cholesky(graph.information)

    def residuals(free: Array) -> Array:
        poses = np.concatenate([path[:1], free.reshape(-1, 3)])
        out = []
        for (a, b), motion, root in zip(graph.ends, graph.motions, roots, strict=True):
            off = relative(motion, relative(poses[a], poses[b]))
            out.append(root.T @ [off[0], off[1], np.remainder(off[2] + np.pi, 2.0 * np.pi) - np.pi])
        return np.concatenate(out)

    other = least_squares(residuals, path[1:].ravel()).x.reshape(-1, 3)
    assert_allclose(fitted(path, graph).poses[1:], other, atol=2e-3)


def test_lenient_weights_fall_with_the_distance_of_a_claim() -> None:
    path, graph = driven(ring(), LOOPS, 0, {2: np.array([1.0, 0.0, 0.0])})
    weights = leniently_fitted(path, graph).weights
    assert weights[graph.claimed].argmin() == 2
    assert weights[graph.claimed][2] < 0.1
    assert np.delete(weights[graph.claimed], 2).min() > 0.5
    assert (weights[~graph.claimed] == 1.0).all()


def test_covariances_of_a_chain_add_up_in_the_axes_of_its_end() -> None:
    poses = np.array([[0.0, 0.0, 0.5], [1.0, 0.0, 0.5], [1.0, 2.0, 0.5]])
    poses[1] = compose(poses[0], np.array([1.0, 0.0, 0.0]))
    poses[2] = compose(poses[1], np.array([2.0, 0.0, 0.0]))
    ends = np.array([[0, 1], [1, 2]])
    graph = PoseGraph(
        ends=ends,
        motions=np.array([relative(poses[a], poses[b]) for a, b in ends]),
        information=np.array([np.diag(SIGMA**-2)] * 2),
        claimed=np.zeros(2, np.bool_),
    )
    marginals = Marginals(FittedPoses(poses=poses, weights=np.ones(2)), graph)
    assert_allclose(marginals.covariance(1, 2), np.diag(SIGMA**2), atol=1e-6)
    # Two metres ahead, a turn at the middle pose moves the end to the side.
    expected = 2.0 * np.diag(SIGMA**2)
    expected[1, 1] += (2.0 * SIGMA[2]) ** 2
    expected[1, 2] = expected[2, 1] = 2.0 * SIGMA[2] ** 2
    assert_allclose(marginals.covariance(0, 2), expected, atol=1e-6)


def test_errors_are_measured_around_the_circle() -> None:
    graph = PoseGraph(
        ends=np.array([[0, 1]]),
        motions=np.array([[0.0, 0.0, np.pi - 0.01]]),
        information=np.eye(3)[None],
        claimed=np.zeros(1, np.bool_),
    )
    poses = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, -np.pi + 0.01]])
    assert squared_errors(poses, graph) == pytest.approx([0.02**2])
