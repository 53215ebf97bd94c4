"""The relative-pose network as an estimator: finds robot 1 in an image, then looks at it closely.

First looks show the whole image small, and smaller still for a near robot. Candidates found there get a close
look, scaled so that the robot has the size at which the network measures best.

Legend: B looks, H W rows and columns of an input, h w of the maps.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import torch

from rendezvous.geometry.camera import Image, PinholeCamera
from rendezvous.geometry.cuboid import project_cuboid
from rendezvous.geometry.se2 import Array
from rendezvous.models.precision import computes_in_bf16
from rendezvous.models.relative_pose_network import RelativePoseNet
from rendezvous.pose_estimation.cuboid_pose import Reading, readings_in_space, readings_on_floor
from rendezvous.pose_estimation.cuboids import DetectedCuboid, detect_cuboids
from rendezvous.pose_estimation.dope_labels import Maps
from rendezvous.pose_estimation.keypoint_evidence import KeypointNoise, evidence_of
from rendezvous.pose_estimation.look import STRIDE_PX, Look
from rendezvous.pose_estimation.observation_model import ObservationModel, SeenRobot
from rendezvous.pose_estimation.peaks import Peaks, belief_peaks
from rendezvous.pose_estimation.pose_calibration import LEAST_READING_MASS, PoseCalibration
from rendezvous.pose_estimation.pose_estimate import PoseMode, RelativePose

FIRST_FOCAL_PX = (308.0, 154.0)
"""Focal lengths of the first looks: at every distance of a sighting, the robot spans 10 to 140 px in one
of them."""
CANDIDATES = 3
_LEAST_CANDIDATE_HEIGHT = 0.03  # least mean height of a candidate's nine peaks in a first look
_WELL_CENTRED_SHARE, _WELL_SCALED = 0.15, 1.3
"""A close look is good if its robot is no further from the middle than this share of the input, and off in
size by less than this factor; otherwise another one is taken."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CloseLook:
    """The inputs on which the network was trained to measure."""

    input_px: int = 160  # side of the square input
    span_px: float = 100.0  # larger side of the box around the projected cuboid there
    sigma_cells: float = 1.0  # standard deviation of the belief maps' Gaussians


@dataclass(frozen=True, slots=True, kw_only=True)
class Looked:
    """The network's output for one look."""

    look: Look  # the part of the image
    belief_9hw: Maps = field(repr=False)  # belief maps
    peaks: Peaks = field(repr=False)  # their maxima
    cuboids: list[DetectedCuboid] = field(repr=False)  # peaks of one cuboid, the most believed first


@dataclass(frozen=True, slots=True, kw_only=True)
class Detection:
    """The place in the image that looks most like the robot."""

    looks: tuple[Looked, ...]  # close looks at it
    readings: tuple[Reading, ...]  # poses read from them, the most probable first; empty if no pose fits


@dataclass(frozen=True, kw_only=True)
class RelativePoseEstimator:
    """Estimates the relative pose of a robot from an image.

    Attributes:
        network: trained, in evaluation mode.
        robot: the robot to look for.
        close: the inputs on which the network measures.
        calibration: how sure to be.
        floor: whether robots stand on one level floor; otherwise poses have six unknowns, as in the paper.
        looks: number of close looks, each a little shifted and scaled.
    """

    network: RelativePoseNet
    robot: SeenRobot
    close: CloseLook = CloseLook()
    calibration: PoseCalibration = field(default_factory=PoseCalibration)
    floor: bool = True
    looks: int = 1

    def __call__(self, image: Image, camera: PinholeCamera, T_r0_c: Array) -> RelativePose:
        """Robot 1's pose; see `ImagePoseEstimator`."""
        sighting = ObservationModel(camera=camera, T_r0_c=T_r0_c, robot=self.robot)
        found = self.detection(image, sighting)
        if found is None:
            return RelativePose.not_found("nothing in the image looks like the robot")
        return self.calibrated(found, sighting)

    def calibrated(self, found: Detection, sighting: ObservationModel) -> RelativePose:
        """The readings after calibration, or why there are none."""
        calibration = self.calibration
        if not found.readings:
            return RelativePose.not_found("what looks like the robot shows too few points for a pose")
        score = calibration.score(found.readings[0])
        if score < calibration.least_score:
            return RelativePose.not_found(
                f"what looks most like the robot scores {score:.3f}; a robot scores at least "
                f"{calibration.least_score:.3f}",
                score=score,
            )
        masses = calibration.masses([reading.log_evidence for reading in found.readings])
        modes = [
            PoseMode(
                T_r0_r1=reading.T_r0_r1,
                covariance=calibration.covariance(reading.covariance, reading.T_r0_r1),
                mass=float(mass),
                T_c_o=reading.T_c_o,
                degrees_of_freedom=calibration.degrees_of_freedom,
            )
            for reading, mass in zip(found.readings, masses, strict=True)
            if mass >= LEAST_READING_MASS
        ]
        return RelativePose(
            modes=tuple(sorted(modes, key=lambda mode: -mode.mass)),
            score=score,
            keypoints_px=_keypoints(found.looks[0], self._projected(found.readings[0], sighting.camera)),
        )

    def detection(self, image: Image, sighting: ObservationModel) -> Detection | None:
        """The place that looks most like the robot; None if nothing does."""
        places = self._candidates(image, sighting.camera)
        if not places:
            return None
        looked = self.see(image, [self._close_look(*place) for place in places])
        best = max(looked, key=lambda one: max((cuboid.score for cuboid in one.cuboids), default=0.0))
        readings = self.readings([best], sighting)
        again = None if not readings else self._better_look(best.look, readings[0], sighting.camera)
        if again is None and self.looks == 1:
            return Detection(looks=(best,), readings=tuple(readings))
        several = tuple(self.see(image, _shaken(again or best.look, self.looks)))
        return Detection(looks=several, readings=tuple(self.readings(several, sighting)))

    def readings(
        self, looks: Sequence[Looked], sighting: ObservationModel, noise: KeypointNoise | None = None
    ) -> list[Reading]:
        """Poses that fit the looks at one robot, with peaks as exact as the calibration, or `noise`, says."""
        evidence = evidence_of(
            [(one.look, one.peaks) for one in looks],
            sigma_cells=self.close.sigma_cells,
            noise=noise or self.calibration.noise,
        )
        first = looks[0]
        if self.floor:
            return readings_on_floor(sighting, evidence, first.look, first.belief_9hw, first.peaks)
        return readings_in_space(sighting, evidence, first.look, first.cuboids)

    def see(self, image: Image, looks: Sequence[Look]) -> list[Looked]:
        """The network's output for looks of one size, in one batch."""
        images = np.stack([look.cut(image).transpose(2, 0, 1) for look in looks])
        belief_B9hw, fields_B16hw = self._maps(torch.from_numpy(images))
        found = []
        for look, belief, vectors in zip(looks, belief_B9hw, fields_B16hw, strict=True):
            peaks = belief_peaks(belief, sigma_cells=self.close.sigma_cells)
            found.append(
                Looked(look=look, belief_9hw=belief, peaks=peaks, cuboids=detect_cuboids(peaks, vectors))
            )
        return found

    @torch.inference_mode()
    def _maps(self, images_B3HW: torch.Tensor) -> tuple[Maps, Maps]:
        """Maps of the last stage, computed in bfloat16 where that is faster."""
        device = next(self.network.parameters()).device
        with torch.autocast(device.type, torch.bfloat16, enabled=computes_in_bf16(device)):
            last = self.network(images_B3HW.to(device))[-1]
        return last.belief_B9hw.float().cpu().numpy(), last.fields_B16hw.float().cpu().numpy()

    def _candidates(self, image: Image, camera: PinholeCamera) -> list[tuple[Array, float]]:
        """Middle [px] and larger side [px] of possible robots, the likeliest first."""
        found = []
        for focal_px in FIRST_FOCAL_PX:
            (looked,) = self.see(image, [first_look(camera, focal_px)])
            for cuboid in looked.cuboids:
                if cuboid.score >= _LEAST_CANDIDATE_HEIGHT and np.count_nonzero(cuboid.height_9) > 1:
                    centre_px = looked.look.to_image(STRIDE_PX * cuboid.centre_cells)
                    found.append((cuboid.score, centre_px, STRIDE_PX * cuboid.span_cells / looked.look.scale))
        kept = list[tuple[Array, float]]()
        for _, centre_px, span_px in sorted(found, key=lambda one: -one[0]):
            if all(np.linalg.norm(centre_px - other) > 0.5 * max(span_px, size) for other, size in kept):
                kept.append((centre_px, span_px))
        return kept[:CANDIDATES]

    def _close_look(self, centre_px: Array, span_px: float) -> Look:
        scale = self.close.span_px / max(span_px, 1.0)
        return Look.at(
            centre_px,
            scale=float(np.clip(scale, 0.1, 4.0)),
            width_px=self.close.input_px,
            height_px=self.close.input_px,
        )

    def _better_look(self, look: Look, reading: Reading, camera: PinholeCamera) -> Look | None:
        """A look at the robot where it was read; None if the look is good already."""
        uv_px = self._projected(reading, camera)
        if not np.isfinite(uv_px).all():
            return None
        low, high = uv_px.min(axis=0), uv_px.max(axis=0)
        better = self._close_look(0.5 * (low + high), float((high - low).max()))
        away_px = np.abs(look.to_input(0.5 * (low + high)) - 0.5 * look.width_px).max()
        ratio = max(better.scale / look.scale, look.scale / better.scale)
        good = away_px < _WELL_CENTRED_SHARE * look.width_px and ratio < _WELL_SCALED
        return None if good else better

    def _projected(self, reading: Reading, camera: PinholeCamera) -> Array:
        return project_cuboid(reading.T_c_o, self.robot.size_m, camera)


def first_look(camera: PinholeCamera, focal_px: float) -> Look:
    """The whole image scaled to this focal length; black beyond its right and lower edge."""
    scale = focal_px / camera.fx_px
    width, height = (
        STRIDE_PX * int(np.ceil(scale * side / STRIDE_PX)) for side in (camera.width_px, camera.height_px)
    )
    shift = 0.5 * (scale - 1.0)
    return Look(scale=scale, offset_px=(shift, shift), width_px=width, height_px=height)


def _shaken(look: Look, count: int) -> list[Look]:
    """A look and others near it: moved by parts of a cell, and scaled a little."""
    turns = np.arange(1, count) * 2.4
    shifts = 0.5 * STRIDE_PX * np.stack([np.cos(turns), np.sin(turns)], axis=1)
    scales = 1.0 + 0.06 * np.cos(2.0 * turns)
    middle = look.to_image(np.full(2, 0.5 * (look.width_px - 1)))
    return [
        look,
        *(
            Look.at(
                middle + shift / look.scale,
                scale=look.scale * float(scale),
                width_px=look.width_px,
                height_px=look.height_px,
            )
            for shift, scale in zip(shifts, scales, strict=True)
        ),
    ]


def _keypoints(looked: Looked, uv_92: Array) -> Array:
    """(9, 2) [px] in the image: for each point the peak that agrees with the pose; NaN if none does."""
    found = np.full((9, 2), np.nan)
    uv_px = looked.look.to_image(STRIDE_PX * looked.peaks.uv_cells_P2)
    near_px = 2.0 * STRIDE_PX / looked.look.scale
    for channel in range(9):
        own = uv_px[looked.peaks.channel_P == channel]
        away = np.linalg.norm(own - uv_92[channel], axis=1)
        if len(own) and away.min() < near_px:
            found[channel] = own[away.argmin()]
    return found
