"""The way from an image to a relative pose, with a network that draws the maps it would learn to make."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import pytest
import torch

from rendezvous.geometry.camera import Image, PinholeCamera
from rendezvous.geometry.se2 import Array
from rendezvous.models.relative_pose_estimator import (
    FIRST_FOCAL_PX,
    Looked,
    RelativePoseEstimator,
    first_look,
)
from rendezvous.models.relative_pose_network import RelativePoseConfig, RelativePoseNet
from rendezvous.pose_estimation.cuboids import detect_cuboids
from rendezvous.pose_estimation.look import Look
from rendezvous.pose_estimation.observation_model import ObservationModel
from rendezvous.pose_estimation.peaks import belief_peaks
from tests.pose_estimation.observations import CAMERA, burger, error, maps_of, observation, state

IMAGE = np.zeros((480, 640, 3), np.uint8)


@dataclass(frozen=True, kw_only=True)
class Drawing(RelativePoseEstimator):
    """Draws the maps of cuboids (N, 9, 2) [px], with a little noise; keeps what it was asked to look at."""

    uv_N92: Array
    height: float = 1.0
    looked: list[Look] = field(default_factory=list)

    def see(self, image: Image, looks: Sequence[Look]) -> list[Looked]:
        self.looked.extend(looks)
        out = []
        for look in looks:
            belief, vectors = maps_of(self.uv_N92, look)
            noise = np.random.default_rng(0).normal(0.0, 0.01, belief.shape)
            belief = (self.height * belief + noise).astype(np.float32)
            peaks = belief_peaks(belief, sigma_cells=1.0)
            out.append(
                Looked(look=look, belief_9hw=belief, peaks=peaks, cuboids=detect_cuboids(peaks, vectors))
            )
        return out


def net() -> RelativePoseNet:
    torch.manual_seed(0)
    return RelativePoseNet(
        RelativePoseConfig(width=16, blocks=0, feature_channels=8, stage_channels=8)
    ).eval()


def drawing(before: ObservationModel, *settings: Array, **changed: float) -> Drawing:
    uv = before.project(np.array(settings).reshape(-1, 6))
    return Drawing(network=net(), robot=burger(), uv_N92=uv, **changed)


def inside(uv_92: Array) -> bool:
    return bool(((uv_92 > 20.0) & (uv_92 < [620.0, 460.0])).all())


@pytest.mark.parametrize("floor", [True, False])
@pytest.mark.parametrize("looks", [1, 3])
def test_a_robot_is_found_wherever_it_stands(floor, looks):
    rng, before, tried = np.random.default_rng(0), observation(), 0
    while tried < 4:
        true = state(rng)
        estimator = replace(drawing(before, true), floor=floor, looks=looks)
        if not inside(estimator.uv_N92[0]):
            continue
        tried += 1
        found = estimator(IMAGE, CAMERA, before.T_r0_c)
        assert found.found, found.reason
        away = error(found.best.T_r0_r1, true)
        assert np.abs(away[:2]).max() < 0.03 * true[0]
        assert abs(away[2]) < 0.06
        assert found.keypoints_px == pytest.approx(estimator.uv_N92[0], abs=3.0)
        span_px = estimator.looked[-1].scale * np.ptp(estimator.uv_N92[0], axis=0).max()
        assert 55.0 < span_px < 110.0


def test_any_image_size_does():
    camera = PinholeCamera(fx_px=910.0, fy_px=910.0, cx_px=644.0, cy_px=361.0, width_px=1283, height_px=717)
    before = ObservationModel(camera=camera, T_r0_c=observation().T_r0_c, robot=burger())
    true = np.array([1.3, 0.2, 2.0, 0.0, 0.0, 0.0])
    found = drawing(before, true)(np.zeros((717, 1283, 3), np.uint8), camera, before.T_r0_c)
    assert error(found.best.T_r0_r1, true) == pytest.approx([0.0, 0.0, 0.0], abs=0.03)
    look = first_look(camera, 308.0)
    assert look.to_input(np.array([-0.5, -0.5])) == pytest.approx([-0.5, -0.5])
    assert look.width_px >= look.scale * 1283 > look.width_px - 8


def test_the_robot_that_is_seen_best_is_read_of_two():
    before = observation()
    one, other = np.array([1.0, 0.25, 0.5, 0, 0, 0]), np.array([2.2, -0.6, 2.5, 0, 0, 0])
    found = drawing(before, one, other)(IMAGE, CAMERA, before.T_r0_c)
    assert min(np.abs(error(found.best.T_r0_r1, true)).max() for true in (one, other)) < 0.05


def test_an_empty_image_gives_a_reason_and_no_pose():
    before = observation()
    found = drawing(before)(IMAGE, CAMERA, before.T_r0_c)
    assert not found.found
    assert found.reason == "nothing in the image looks like the robot"
    assert np.isnan(found.keypoints_px).all()


def test_what_is_hardly_like_a_robot_is_none():
    before = observation()
    true = np.array([1.3, 0.2, 2.0, 0.0, 0.0, 0.0])
    faint = drawing(before, true, height=0.15)
    found = faint(IMAGE, CAMERA, before.T_r0_c)
    assert not found.found
    assert "what looks most like the robot scores 0." in found.reason
    assert 0.0 < found.score < 0.5
    bold = replace(faint, calibration=replace(faint.calibration, least_score=0.0))
    assert bold(IMAGE, CAMERA, before.T_r0_c).found
    just = replace(faint, calibration=replace(faint.calibration, least_score=found.score))
    assert just(IMAGE, CAMERA, before.T_r0_c).found


def test_one_close_look_is_taken_unless_more_are_asked_for():
    before = observation()
    estimator = drawing(before, np.array([1.3, 0.2, 2.0, 0.0, 0.0, 0.0]))
    detection = estimator.detection(IMAGE, before)
    assert detection is not None
    assert len(detection.looks) == 1
    assert estimator.looks == 1


@pytest.mark.parametrize("x_m", [0.4, 0.6, 1.2, 2.5, 4.5])
def test_some_first_look_shows_a_robot_at_a_size_that_was_trained(x_m: float):
    uv_92 = observation().project(np.array([[x_m, 0.0, 0.6, 0.0, 0.0, 0.0]]))[0]
    spans_px = [first_look(CAMERA, f).scale * np.ptp(uv_92, axis=0).max() for f in FIRST_FOCAL_PX]
    assert any(10.0 < span_px < 140.0 for span_px in spans_px)


@dataclass(frozen=True, kw_only=True)
class Glimpsing(Drawing):
    """Sees one corner and the centroid in first looks, so that it takes the robot to be small."""

    def see(self, image: Image, looks: Sequence[Look]) -> list[Looked]:
        if looks[0].height_px == self.close.input_px:
            return super().see(image, looks)
        points = np.where(np.isin(np.arange(9), (0, 8))[:, None], self.uv_N92, np.nan)
        return super(Glimpsing, replace(self, uv_N92=points)).see(image, looks)


def test_a_robot_that_was_glimpsed_is_looked_at_again_where_it_was_read():
    before, true = observation(), np.array([1.3, 0.2, 2.0, 0.0, 0.0, 0.0])
    estimator = Glimpsing(network=net(), robot=burger(), uv_N92=before.project(true[None]))
    found = estimator(IMAGE, CAMERA, before.T_r0_c)
    assert error(found.best.T_r0_r1, true) == pytest.approx([0.0, 0.0, 0.0], abs=0.03)
    points_px = estimator.looked[-1].to_input(estimator.uv_N92[0])
    low, high = points_px.min(axis=0), points_px.max(axis=0)
    assert 0.5 * (low + high) == pytest.approx([79.5, 79.5], abs=5.0)
    assert (high - low).max() == pytest.approx(estimator.close.span_px, rel=0.06)


def test_several_looks_see_points_at_different_places_in_a_cell():
    before, true = observation(), np.array([1.3, 0.2, 2.0, 0.0, 0.0, 0.0])
    estimator = drawing(before, true, looks=4)
    estimator(IMAGE, CAMERA, before.T_r0_c)
    places = [look.to_input(estimator.uv_N92[0, 8]) for look in estimator.looked[-4:]]
    apart_px = [np.hypot(*(a - b)) for i, a in enumerate(places) for b in places[:i]]
    assert min(apart_px) > 1.0
    assert max(apart_px) < 16.0


def test_the_calibration_widens_what_is_told():
    before = observation()
    true = np.array([2.0, 0.0, 1.0, 0.0, 0.0, 0.0])
    narrow = drawing(before, true)
    wide = replace(narrow, calibration=replace(narrow.calibration, along_share=0.1))
    covariances = [one(IMAGE, CAMERA, before.T_r0_c).best.covariance for one in (narrow, wide)]
    added = covariances[1] - covariances[0]
    assert np.trace(added[:2, :2]) == pytest.approx((0.1**2 - 0.02**2) * 2.0**2, rel=0.05)


def test_a_network_answers_any_image():
    rng, before = np.random.default_rng(0), observation()
    estimator = RelativePoseEstimator(network=net(), robot=burger())
    found = estimator(rng.integers(0, 255, (480, 640, 3), np.uint8), CAMERA, before.T_r0_c)
    assert not found.found
    assert found.reason


def test_at_most_three_places_are_looked_at_closely_and_each_once():
    five = [np.array([3.0, y_m, 0.5, 0.0, 0.0, 0.0]) for y_m in (-1.2, -0.6, 0.0, 0.6, 1.2)]
    places = drawing(observation(), *five)._candidates(IMAGE, CAMERA)
    assert len(places) == 3
    columns = sorted(centre_px[0] for centre_px, _ in places)
    assert np.diff(columns).min() > 100.0  # 0.6 m at 3 m are 123 px
    # Both first looks show a robot; its place and size are those in the image.
    ((centre_px, span_px),) = drawing(observation(), five[2])._candidates(IMAGE, CAMERA)
    uv_92 = observation().project(five[2][None])[0]
    assert centre_px == pytest.approx(0.5 * (uv_92.min(axis=0) + uv_92.max(axis=0)), abs=2.0)
    assert span_px == pytest.approx(np.ptp(uv_92, axis=0).max(), abs=3.0)
