"""Sightings whose truth is known, and what a network that makes small errors would say of them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rendezvous.geometry.camera import PinholeCamera, camera_pose
from rendezvous.geometry.se2 import SE2, Array
from rendezvous.pose_estimation.cuboids import DetectedCuboid, detect_cuboids
from rendezvous.pose_estimation.dope_labels import Maps, belief_maps, vector_fields
from rendezvous.pose_estimation.keypoint_evidence import KeypointEvidence, KeypointNoise, evidence_of
from rendezvous.pose_estimation.look import STRIDE_PX, Look
from rendezvous.pose_estimation.observation_model import ObservationModel, SeenRobot
from rendezvous.pose_estimation.peaks import Peaks, belief_peaks

CAMERA = PinholeCamera(fx_px=616.0, fy_px=616.0, cx_px=319.5, cy_px=239.5, width_px=640, height_px=480)
INPUT_PX, SPAN_PX = 160, 80.0
EXACT = KeypointNoise(floor_cells=0.01, scale=0.1)


def burger() -> SeenRobot:
    T_r1_o = np.eye(4)
    T_r1_o[:3, 3] = -0.032, 0.0, 0.096
    return SeenRobot(size_m=(0.138, 0.178, 0.192), T_r1_o=T_r1_o)


def observation(*, pitch_rad: float = 0.0) -> ObservationModel:
    T_r0_c = camera_pose(np.array([0.034, 0.0, 0.12]), np.array([0.0, pitch_rad, 0.0]))
    return ObservationModel(camera=CAMERA, T_r0_c=T_r0_c, robot=burger())


def state(rng: np.random.Generator, *, lean: float = 1.0) -> Array:
    """(6,) uniform: somewhere in view, facing anywhere; normal: the camera leans a little."""
    x_m = rng.uniform(0.5, 3.5)
    pose = [x_m, x_m * rng.uniform(-0.3, 0.3), rng.uniform(-np.pi, np.pi)]
    return np.array([*pose, *(lean * rng.normal(0.0, [0.003, 0.012, 0.012]))])


def maps_of(uv_N92: Array, look: Look) -> tuple[Maps, Maps]:
    """Belief maps and vector fields of points (N, 9, 2) of the image."""
    size = {"width_px": look.width_px, "height_px": look.height_px, "stride_px": STRIDE_PX}
    points = look.to_input(uv_N92)
    return belief_maps(points, **size, sigma_cells=1.0), vector_fields(points, **size, radius_cells=2)


def look_at(uv_92: Array) -> Look:
    """A close look at points of the image."""
    low, high = np.nanmin(uv_92, axis=0), np.nanmax(uv_92, axis=0)
    return Look.at(
        0.5 * (low + high),
        scale=SPAN_PX / float((high - low).max()),
        width_px=INPUT_PX,
        height_px=INPUT_PX,
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class Seen:
    """A look and what is read of it."""

    look: Look
    belief_9hw: Maps
    peaks: Peaks
    cuboids: list[DetectedCuboid]

    def evidence(self, noise: KeypointNoise = EXACT) -> KeypointEvidence:
        return evidence_of([(self.look, self.peaks)], sigma_cells=1.0, noise=noise)


def seen(look: Look, belief_9hw: Maps, fields_16hw: Maps) -> Seen:
    peaks = belief_peaks(belief_9hw, sigma_cells=1.0)
    return Seen(look=look, belief_9hw=belief_9hw, peaks=peaks, cuboids=detect_cuboids(peaks, fields_16hw))


def seen_points(uv_92: Array) -> Seen:
    """A close look at points; NaN for one that leaves no trace."""
    look = look_at(uv_92)
    return seen(look, *maps_of(uv_92[None], look))


def shaken(rng: np.random.Generator, uv_92: Array, *, cells: float) -> Array:
    """The points with normal errors, the standard deviation in cells of a close look."""
    noise: Array = cells * STRIDE_PX / look_at(uv_92).scale * rng.normal(size=uv_92.shape)
    return uv_92 + noise


def error(estimate: SE2, state_6: Array) -> Array:
    """(3,) of the components of `T_estimated⁻¹ T_true`."""
    return (estimate.inverse() @ SE2.from_array(state_6[:3])).wrapped().as_array()
