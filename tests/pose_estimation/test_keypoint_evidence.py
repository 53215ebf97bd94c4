from __future__ import annotations

import numpy as np
import pytest

from rendezvous.pose_estimation.keypoint_evidence import KeypointNoise, evidence_of
from rendezvous.pose_estimation.look import Look
from rendezvous.pose_estimation.peaks import Peaks

LOOK = Look.at(np.array([200.0, 150.0]), scale=0.5, width_px=160, height_px=160)
PX_PER_CELL = 16.0


def peaks(*heights: float, channel: int = 3) -> Peaks:
    """Peaks of one map, far from each other."""
    places = [[4.0 + 6.0 * i, 5.0] for i in range(len(heights))]
    return Peaks(
        channel_P=np.full(len(heights), channel), uv_cells_P2=np.array(places), height_P=np.array(heights)
    )


@pytest.mark.parametrize("height", [1.0, 0.5, 0.2])
def test_a_low_peak_leaves_the_variance_that_has_blurred_it(height: float):
    noise = KeypointNoise(floor_cells=0.1, scale=1.0)
    evidence = evidence_of([(LOOK, peaks(height))], sigma_cells=1.5, noise=noise)
    # A target of variance 1.5², blurred by s², has the height 1.5² / (1.5² + s²).
    blur = 1.5**2 / height - 1.5**2
    assert evidence.variance_px2_GJ[3, 0] == pytest.approx(PX_PER_CELL**2 * (0.1**2 + blur))


def test_a_density_is_one_over_the_look():
    evidence = evidence_of([(LOOK, peaks(0.6, 0.3))], sigma_cells=1.0, noise=KeypointNoise())
    side_px = 160.0 / LOOK.scale
    grid = np.stack(np.meshgrid(*[np.arange(0.5, side_px)] * 2), axis=-1).reshape(-1, 2)
    uv_px = LOOK.to_image((grid - 0.5 * side_px) * LOOK.scale + 79.5)
    density = np.exp(evidence.log_densities(np.repeat(uv_px[:, None], 9, axis=1))[0])
    assert density.sum(axis=0) == pytest.approx(np.ones(9), abs=0.01)


def test_several_looks_count_as_one():
    found = [(LOOK, peaks(0.6, 0.3))]
    uv = np.repeat(LOOK.to_image(np.array([[32.0, 40.0]])), 9, axis=0)[None]
    once, twice = (evidence_of(found * n, sigma_cells=1.0, noise=KeypointNoise()) for n in (1, 2))
    assert once.log_likelihood(uv) > 1.0
    assert twice.log_likelihood(uv) == pytest.approx(once.log_likelihood(uv))


def test_a_peak_s_share_is_its_probability_near_it_and_none_elsewhere():
    evidence = evidence_of([(LOOK, peaks(0.6, 0.3))], sigma_cells=1.0, noise=KeypointNoise())
    first, second, away = (
        np.repeat(LOOK.to_image(np.array([[u, 40.0]])), 9, axis=0)[None] for u in (32.0, 80.0, 140.0)
    )
    shares = [evidence.log_densities(uv)[1][0, 3] for uv in (first, second, away)]
    assert shares[0][:2] == pytest.approx([1.0, 0.0], abs=0.01)
    assert shares[1][:2] == pytest.approx([0.0, 1.0], abs=0.01)
    assert shares[2] == pytest.approx(np.zeros(4), abs=1e-6)
    assert evidence.weight_GJ[3, :2] == pytest.approx([0.98 * 0.6, 0.98 * 0.3])


def test_peaks_of_more_than_one_in_all_share_what_is_sure():
    evidence = evidence_of([(LOOK, peaks(0.9, 0.6))], sigma_cells=1.0, noise=KeypointNoise())
    assert evidence.weight_GJ[3] == pytest.approx([0.98 * 0.6, 0.98 * 0.4, 0.0, 0.0])
    assert evidence.variance_px2_GJ[3] == pytest.approx(np.full(4, (0.1 * PX_PER_CELL) ** 2))
    assert evidence.elsewhere_G[3] == pytest.approx(0.02 / 320.0**2)
    assert evidence.cell_px == PX_PER_CELL


def test_three_tenths_of_a_peaks_blur_is_taken_as_doubt_unless_told():
    evidence = evidence_of([(LOOK, peaks(0.5))], sigma_cells=1.0, noise=KeypointNoise())
    assert evidence.variance_px2_GJ[3, 0] == pytest.approx(PX_PER_CELL**2 * (0.1**2 + 0.3 * 1.0))


def test_each_look_has_its_own_scale_and_place():
    far = Look.at(np.array([100.0, 50.0]), scale=0.25, width_px=80, height_px=80)
    evidence = evidence_of(
        [(LOOK, peaks(1.0)), (far, peaks(1.0, channel=5))], sigma_cells=1.0, noise=KeypointNoise()
    )
    assert evidence.uv_px_GJ2[3, 0] == pytest.approx(LOOK.to_image(np.array([32.0, 40.0])))
    assert evidence.uv_px_GJ2[9 + 5, 0] == pytest.approx(far.to_image(np.array([32.0, 40.0])))
    assert evidence.channel_G.tolist() == [*range(9), *range(9)]
    assert evidence.variance_px2_GJ[[3, 14], 0] == pytest.approx([1.6**2, 3.2**2])
    assert evidence.cell_px == pytest.approx(0.5 * (16.0 + 32.0))
