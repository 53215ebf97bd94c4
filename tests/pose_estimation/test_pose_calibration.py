from __future__ import annotations

import numpy as np
import pytest

from rendezvous.alignment.frame_error import ellipsoid_probability, nees
from rendezvous.errors import ConfigError
from rendezvous.geometry.se2 import SE2, Array
from rendezvous.pose_estimation.cuboid_pose import Reading
from rendezvous.pose_estimation.keypoint_evidence import KeypointNoise
from rendezvous.pose_estimation.pose_calibration import PoseCalibration
from rendezvous.pose_estimation.pose_calibration_fit import (
    ReadImage,
    SeenPeaks,
    _least_score,
    fitted,
    likeliest_noise,
    with_score,
    with_sharpness,
)
from tests.pose_estimation.observations import observation, seen_points, shaken, state


def reading(
    T_r0_r1: SE2, *, covariance: Array | None = None, log_evidence: float = 0.0, explained: float = 0.8
) -> Reading:
    return Reading(
        T_r0_r1=T_r0_r1,
        covariance=np.diag([1e-6, 1e-6, 1e-6]) if covariance is None else covariance,
        T_c_o=np.eye(4),
        log_evidence=log_evidence,
        explained=explained,
        gain=60.0 * explained,
    )


def images(rng: np.random.Generator, calibration: PoseCalibration, count: int) -> list[ReadImage]:
    """Readings whose errors follow the calibration; every fifth image is without the robot."""
    nu = calibration.degrees_of_freedom
    out = []
    for number in range(count):
        true = SE2(rng.uniform(0.5, 4.0), rng.uniform(-1.0, 1.0), rng.uniform(-3.0, 3.0))
        covariance = np.diag(rng.uniform(0.3, 3.0) * np.array([2e-4, 1e-4, 3e-4]))
        error = rng.multivariate_normal(np.zeros(3), calibration.covariance(covariance, true))
        error *= np.sqrt((nu - 2.0) / rng.chisquare(nu))
        if number % 5:
            read = reading(true @ SE2.from_array(error).inverse(), covariance=covariance,
                           explained=rng.uniform(0.6, 0.95))  # fmt: skip
            out.append(ReadImage(readings=(read,), T_r0_r1=true))
        else:
            read = reading(true, explained=rng.uniform(0.05, 0.5))
            out.append(ReadImage(readings=(read,), T_r0_r1=None))
    return out


@pytest.mark.parametrize("tails", [4.0, 1000.0])
def test_the_spread_of_errors_is_found_again(tails):
    rng = np.random.default_rng(0)
    true = PoseCalibration(
        scale=1.5,
        along_share=0.03,
        across_share=0.004,
        floor_m=0.004,
        floor_rad=0.03,
        degrees_of_freedom=tails,
    )
    found = fitted(KeypointNoise(), images(rng, true, 300))
    assert found.along_share == pytest.approx(0.03, rel=0.25)
    assert found.across_share < 0.015
    assert found.floor_rad == pytest.approx(0.03, rel=0.3)
    assert (found.degrees_of_freedom < 8.0) == (tails == 4.0)
    there = [image for image in images(rng, true, 600) if image.T_r0_r1 is not None]
    errors = np.array([image.errors_M3()[0] for image in there])
    reads = [image.readings[0] for image in there]
    covariances = [found.covariance(read.covariance, read.T_r0_r1) for read in reads]
    degrees = np.full(len(errors), found.degrees_of_freedom)
    held = ellipsoid_probability(nees(errors, np.array(covariances)), degrees)
    for level in (0.5, 0.9, 0.95):
        assert np.mean(held <= level) == pytest.approx(level, abs=0.06)


def test_variance_along_the_line_of_sight_is_added_along_it():
    calibration = PoseCalibration(along_share=0.1, across_share=0.0, floor_m=0.0, floor_rad=0.0)
    # Robot 1 is to the left and faces ahead, so the line of sight is its own y axis.
    added = calibration.covariance(np.zeros((3, 3)), SE2(0.0, 2.0, 0.0))
    assert added == pytest.approx(np.diag([0.0, 0.04, 0.0]), abs=1e-12)
    turned = calibration.covariance(np.zeros((3, 3)), SE2(0.0, 2.0, np.pi / 2.0))
    assert turned == pytest.approx(np.diag([0.04, 0.0, 0.0]), abs=1e-12)
    aslant = calibration.covariance(np.zeros((3, 3)), SE2(0.0, 2.0, 0.5))
    along = np.array([np.cos(0.5 * np.pi - 0.5), np.sin(0.5 * np.pi - 0.5), 0.0])
    assert aslant == pytest.approx(0.04 * np.outer(along, along), abs=1e-12)


def test_scale_and_floors_are_added_up():
    calibration = PoseCalibration(along_share=0.0, across_share=0.0, scale=2.0, floor_m=0.1, floor_rad=0.2)
    covariance = calibration.covariance(np.diag([0.01, 0.02, 0.03]), SE2(1.0, 2.0, 3.0))
    assert covariance == pytest.approx(np.diag([0.03, 0.05, 0.10]))
    across = PoseCalibration(along_share=0.0, across_share=0.1, floor_m=0.0, floor_rad=0.0)
    assert across.covariance(np.zeros((3, 3)), SE2(0.0, 2.0, 0.0)) == pytest.approx(np.diag([0.04, 0.0, 0.0]))


@pytest.mark.parametrize(("wrong_images", "least"), [(100, 0.75), (200, 0.55)])
def test_the_least_score_lets_half_a_percent_of_images_without_a_robot_through(
    wrong_images: int, least: float
):
    scores = np.array([0.9, 0.8, 0.6, 0.7, 0.5, 0.1])
    right = np.array([True, True, True, False, False, False])
    assert _least_score(scores, right, wrong_images) == pytest.approx(least)


@pytest.mark.parametrize(("away_m", "right"), [(0.29, True), (0.31, False)])
def test_a_reading_is_right_within_a_distance_that_grows_with_the_robot_s(away_m: float, right: bool):
    near, far = SE2(1.0, 0.0, 0.0), SE2(4.0, 0.0, 0.0)
    for true, scale in ((near, 1.0), (far, 2.0)):
        read = reading(SE2(true.x_m, scale * away_m, 3.0))
        assert ReadImage(readings=(read,), T_r0_r1=true).right == right
    assert not ReadImage(readings=(reading(near),), T_r0_r1=None).right
    assert not ReadImage(readings=(), T_r0_r1=near).right


def test_few_images_without_a_robot_reach_the_least_score():
    rng = np.random.default_rng(1)
    found = with_score(PoseCalibration(), images(rng, PoseCalibration(), 400))
    scores = [
        (found.score(image.readings[0]) >= found.least_score, image.T_r0_r1 is not None)
        for image in images(rng, PoseCalibration(), 400)
    ]
    assert np.mean([is_found for is_found, there in scores if not there]) <= 0.01
    assert np.mean([is_found for is_found, there in scores if there]) >= 0.98


def test_more_agreement_never_counts_against_a_robot():
    rng = np.random.default_rng(2)
    upside_down = [
        ReadImage(readings=image.readings, T_r0_r1=None if image.T_r0_r1 else image.readings[0].T_r0_r1)
        for image in images(rng, PoseCalibration(), 100)
    ]
    found = with_score(PoseCalibration(), upside_down)
    assert found.of_explained >= 0.0
    assert found.of_gain >= 0.0


def test_readings_are_as_probable_as_they_are_right():
    rng = np.random.default_rng(3)
    right = []
    for _ in range(400):
        true = SE2(rng.uniform(0.5, 3.0), 0.0, 0.0)
        behind = true @ SE2(0.0, 0.0, np.pi)
        stated = rng.normal(0.0, 8.0)
        # The evidence as stated is four times too sure.
        truth = true if rng.random() < 1.0 / (1.0 + np.exp(-stated / 4.0)) else behind
        both = [reading(true, log_evidence=stated), reading(behind)]
        both.sort(key=lambda one: -one.log_evidence)
        right.append(ReadImage(readings=tuple(both), T_r0_r1=truth))
    assert with_sharpness(PoseCalibration(), right).sharpness == pytest.approx(0.25, rel=0.3)
    alone = ReadImage(readings=(reading(SE2(1.0, 0.0, 0.0)),), T_r0_r1=SE2(1.0, 0.0, 0.0))
    assert with_sharpness(PoseCalibration(), [*right, alone]) == with_sharpness(PoseCalibration(), right)
    assert PoseCalibration(sharpness=0.5).masses([0.0, -2.0]) == pytest.approx([0.731, 0.269], abs=1e-3)


def test_probabilities_stay_where_no_image_has_several_readings():
    rng = np.random.default_rng(6)
    right = [image for image in images(rng, PoseCalibration(), 50) if image.right]
    assert with_sharpness(PoseCalibration(), right).sharpness == pytest.approx(1.0)


@pytest.mark.parametrize("cells", [0.08, 0.3])
def test_the_noise_of_peaks_is_found_again(cells):
    rng, before = np.random.default_rng(4), observation()
    looks = []
    for _ in range(20):
        uv_px = before.project(state(rng)[None])[0]
        found = seen_points(shaken(rng, uv_px, cells=cells))
        looks.append(SeenPeaks(look=found.look, peaks=found.peaks, uv_px=uv_px))
    assert likeliest_noise(looks, sigma_cells=1.0).floor_cells == pytest.approx(cells, rel=0.25)


def test_a_calibration_is_kept_as_numbers():
    calibration = PoseCalibration(along_share=0.01, sharpness=0.3, least_score=0.7)
    assert PoseCalibration.from_dict(calibration.as_dict()) == calibration
    with pytest.raises(ConfigError, match="must hold numbers"):
        PoseCalibration.from_dict({**calibration.as_dict(), "bias": "high"})
    with pytest.raises(ConfigError, match="must hold numbers"):
        PoseCalibration.from_dict({"bias": 1.0})
    with pytest.raises(ConfigError, match="least_score"):
        PoseCalibration.from_dict({**calibration.as_dict(), "least_score": 1.5})
