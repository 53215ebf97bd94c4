from __future__ import annotations

import numpy as np
import pytest

from rendezvous.geometry.se2 import Array
from rendezvous.pose_estimation.keypoint_evidence import KeypointEvidence, KeypointNoise
from rendezvous.pose_estimation.observation_model import HEIGHT_SIGMA_M, TILT_SIGMA_RAD, ObservationModel
from rendezvous.pose_estimation.state_refinement import lean_precision, refine
from tests.pose_estimation.observations import observation, seen_points, shaken, state

NOISE = KeypointNoise(floor_cells=0.2, scale=0.0)


def log_posterior(
    before: ObservationModel, evidence: KeypointEvidence, states_M6: Array, *, floor: bool
) -> Array:
    lean = 0.5 * (lean_precision(floor=floor) * states_M6**2).sum(axis=1)
    return evidence.log_likelihood(before.project(states_M6)) - lean


def shaken_observation(seed: int) -> tuple[ObservationModel, KeypointEvidence, Array]:
    """Peaks that are off by as much as the noise says."""
    rng, before = np.random.default_rng(seed), observation()
    true = state(rng)
    uv_92 = shaken(rng, before.project(true[None])[0], cells=0.2)
    return before, seen_points(uv_92).evidence(NOISE), true


@pytest.mark.parametrize("floor", [True, False])
@pytest.mark.parametrize("seed", range(4))
def test_no_setting_nearby_is_more_probable(seed: int, floor: bool):
    before, evidence, true = shaken_observation(seed)
    found = refine(before, evidence, true[None] + 0.01, floor=floor)
    spread = np.linalg.cholesky(found.covariance_M66[0])
    steps = np.random.default_rng(9).normal(size=(400, 6)) @ spread.T
    for share in (0.3, 0.03):
        near = log_posterior(before, evidence, found.states_M6 + share * steps, floor=floor)
        best = log_posterior(before, evidence, found.states_M6, floor=floor)
        assert near.max() < best[0] + 2e-3


@pytest.mark.parametrize("seed", range(3))
def test_the_evidence_is_the_integral_of_the_posterior(seed: int):
    before, evidence, true = shaken_observation(seed)
    found = refine(before, evidence, true[None], floor=True)
    # Importance sampling from a normal distribution one and a half times as wide.
    draws = np.random.default_rng(5).normal(size=(20_000, 6))
    spread = 1.5 * np.linalg.cholesky(found.covariance_M66[0])
    log_drawn = -0.5 * (draws**2).sum(axis=1) - 3.0 * np.log(2.0 * np.pi) - np.log(np.diag(spread)).sum()
    values = log_posterior(before, evidence, found.states_M6 + draws @ spread.T, floor=True) - log_drawn
    integral = np.log(np.exp(values - values.max()).mean()) + values.max()
    # Laplace's approximation, up to the constant of six dimensions.
    assert found.log_evidence_M[0] + 3.0 * np.log(2.0 * np.pi) == pytest.approx(integral, abs=0.2)


def test_a_floor_that_is_not_to_be_used_leaves_height_and_tilt_open():
    before, evidence, _ = shaken_observation(0)
    # As seen by a camera 5 cm higher than stated.
    high = np.array([1.2, 0.1, 0.8, 0.05, 0.0, 0.0])
    evidence = seen_points(before.project(high[None])[0]).evidence(NOISE)
    open_, floored = (refine(before, evidence, high[None], floor=floor) for floor in (False, True))
    assert open_.states_M6[0] == pytest.approx(high, abs=0.02)
    assert abs(floored.states_M6[0, 3]) < 0.02
    assert floored.gain_M[0] < open_.gain_M[0]


def test_peaks_that_all_agree_explain_all_that_can_be_explained():
    before = observation()
    true = np.array([1.5, 0.1, 0.8, 0.0, 0.0, 0.0])
    points = seen_points(before.project(true[None])[0])
    found = refine(before, points.evidence(NOISE), true[None], floor=True)
    assert found.explained_M[0] == pytest.approx(0.98, abs=0.01)
    assert found.gain_M[0] == pytest.approx(
        points.evidence(NOISE).log_likelihood(before.project(found.states_M6))[0]
    )
    astray = before.project(true[None])[0]
    astray[3] += 60.0
    found = refine(before, seen_points(astray).evidence(NOISE), true[None], floor=True)
    assert found.explained_M[0] == pytest.approx(0.98 * 8 / 9, abs=0.01)


def test_height_and_tilt_are_as_sure_as_a_level_floor_makes_them():
    assert lean_precision(floor=True) == pytest.approx(
        [0, 0, 0, HEIGHT_SIGMA_M**-2, *[TILT_SIGMA_RAD**-2] * 2]
    )
    assert lean_precision(floor=False) == pytest.approx([0, 0, 0, 0.01, 0.01, 0.01])
