"""A differential-drive robot: dimensions, limits, sensors. Frame r: on the floor between the wheels."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, fields, replace
from typing import Any

import numpy as np

from rendezvous.errors import ConfigError, require_within
from rendezvous.geometry.camera import PinholeCamera, camera_pose
from rendezvous.geometry.cuboid import Vec3
from rendezvous.geometry.se2 import Array

_TURN_RAD = 2.0 * math.pi
CONTROL_HZ = 20.0  # rate of the wheel controller and of the encoders
_POSITIVE = ("radius_m", "mass_kg", "width_m", "track_m", "size_m", "rate_hz", "speed_mps", "rate_radps")


@dataclass(frozen=True, slots=True, kw_only=True)
class Chassis:
    """The body as an upright cylinder [m]."""

    radius_m: float
    centre_x_m: float
    bottom_z_m: float
    top_z_m: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Wheels:
    """The two driven wheels; `mass_kg` is one wheel's."""

    radius_m: float
    width_m: float
    track_m: float
    mass_kg: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Caster:
    """The passive ball caster behind the wheels."""

    x_m: float
    radius_m: float


@dataclass(frozen=True, slots=True, kw_only=True)
class LidarNoise:
    """Range noise of the lidar: sigma = hypot(sigma_m, sigma_ratio * range), steps of `step_m`, lost echoes.

    SLAM knows the same sigma, as a data sheet gives it.
    """

    sigma_m: float
    sigma_ratio: float
    step_m: float
    dropout: float

    def __post_init__(self) -> None:
        require_within(self, sigma_m=(0, 1), sigma_ratio=(0, 0.5), step_m=(0, 0.5), dropout=(0, 1))


@dataclass(frozen=True, slots=True, kw_only=True)
class LidarSpec:
    """A spinning lidar on the robot's axis; its axes are those of r."""

    x_m: float
    z_m: float
    cap_radius_m: float  # radius of its housing, which another robot's lidar sees
    beams: int
    rate_hz: float
    range_min_m: float
    range_max_m: float
    no_echo_free_m: float  # how far a beam clears the map if it and its neighbours have no echo
    noise: LidarNoise
    field_of_view_rad: float = _TURN_RAD  # centred straight ahead
    turn_hz: float | None = None  # turns per second, of which `rate_hz` sweeps are used; null: all
    normals_to_m: float = 0.0  # walls nearer than this are seen as lines however far apart the beams are

    def sweep_s(self) -> float:
        """How long a sweep takes, from its first beam to its last."""
        return self.field_of_view_rad / (_TURN_RAD) / (self.turn_hz or self.rate_hz)

    def step_rad(self) -> float:
        """Angle between neighbouring beams."""
        gaps = self.beams if self.sees_all_round() else self.beams - 1
        return self.field_of_view_rad / gaps

    def sees_all_round(self) -> bool:
        """Whether the last beam is the first one's neighbour."""
        return self.field_of_view_rad >= _TURN_RAD

    def clears_m(self) -> float:
        """How far beams without echo clear the map: noise hides echoes from just within the range."""
        return min(self.no_echo_free_m, 0.9 * self.range_max_m)


_LATER_FIELDS = ("field_of_view_rad", "turn_hz", "normals_to_m")
"""Of a lidar; shards made before there were these are as those with their defaults."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Lidar:
    """A lidar by its data sheet, to be put on any robot; fields as of `LidarSpec`."""

    beams: int
    field_of_view_rad: float
    turn_hz: float
    rate_hz: float
    range_min_m: float
    range_max_m: float
    no_echo_free_m: float
    normals_to_m: float
    noise: LidarNoise


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraSpec:
    """A camera's mounting (of its body, x forward) and intrinsics."""

    xyz_m: Vec3
    rpy_rad: Vec3
    fx_px: float
    fy_px: float
    cx_px: float
    cy_px: float
    width_px: int
    height_px: int

    def intrinsics(self) -> PinholeCamera:
        """The pinhole model."""
        return PinholeCamera(**{f.name: getattr(self, f.name) for f in fields(PinholeCamera)})

    def T_r_c(self) -> Array:
        """(4, 4) pose of the optical frame in r."""
        return camera_pose(np.array(self.xyz_m), np.array(self.rpy_rad))


@dataclass(frozen=True, slots=True, kw_only=True)
class Cuboid:
    """The box around the robot whose corners are DOPE's keypoints; axes of r."""

    size_m: Vec3
    centre_m: Vec3

    def T_r_o(self) -> Array:
        """(4, 4) pose of the object frame in r."""
        T_r_o = np.eye(4)
        T_r_o[:3, 3] = self.centre_m
        return T_r_o


@dataclass(frozen=True, slots=True, kw_only=True)
class RobotSpec:
    """All that the pipeline knows about a robot, as read from `assets/robots/<name>/robot.yaml`."""

    name: str
    size_m: Vec3
    radius_m: float
    mass_kg: float
    max_speed_mps: float
    max_turn_rate_radps: float
    chassis: Chassis
    wheels: Wheels
    caster: Caster
    lidar: LidarSpec
    camera: CameraSpec
    cuboid: Cuboid

    def __post_init__(self) -> None:
        for name, value in _numbers(asdict(self)):
            if name.endswith(_POSITIVE) and not value > 0.0:
                raise ConfigError(f"robot {self.name}: {name} is {value}; must be positive")
        require_within(self.camera, width_px=(1, 20_000), height_px=(1, 20_000))
        self._check_lidar()
        chassis = self.chassis
        if not chassis.bottom_z_m < chassis.top_z_m <= self.size_m[2]:
            raise ConfigError(
                f"robot {self.name}: the chassis reaches from {chassis.bottom_z_m} to {chassis.top_z_m} m; "
                f"its top must be above its bottom and at most the robot's height of {self.size_m[2]} m"
            )
        if not min(0.0, self.caster.x_m) < chassis.centre_x_m < max(0.0, self.caster.x_m):
            raise ConfigError(
                f"robot {self.name}: chassis.centre_x_m is {chassis.centre_x_m}; must be between the wheels "
                f"at 0 and the caster at {self.caster.x_m} m, or the robot tips over"
            )
        if 2 * self.wheels.mass_kg >= self.mass_kg:
            raise ConfigError(
                f"robot {self.name}: two wheels of {self.wheels.mass_kg} kg are not part of {self.mass_kg} kg"
            )

    def _check_lidar(self) -> None:
        lidar = self.lidar
        require_within(lidar, beams=(0, 100_000), field_of_view_rad=(0.1, _TURN_RAD), normals_to_m=(0, 100))
        if not 0.0 < lidar.z_m <= self.size_m[2]:
            raise ConfigError(
                f"robot {self.name}: lidar.z_m is {lidar.z_m}; must be within the robot's {self.size_m[2]} m"
            )
        if lidar.beams < 8 or not 0.0 <= lidar.range_min_m < lidar.range_max_m:
            raise ConfigError(
                f"robot {self.name}: lidar with {lidar.beams} beams from {lidar.range_min_m} to "
                f"{lidar.range_max_m} m; needs at least 8 beams and a range"
            )
        ticks = CONTROL_HZ / lidar.rate_hz
        if round(ticks) < 1 or abs(ticks - round(ticks)) > 1e-9:
            raise ConfigError(
                f"robot {self.name}: lidar.rate_hz is {lidar.rate_hz}; must divide the controller's "
                f"{CONTROL_HZ:g} Hz, such as 5 or 10"
            )
        if lidar.turn_hz is not None and lidar.turn_hz < lidar.rate_hz:
            raise ConfigError(
                f"robot {self.name}: lidar.turn_hz is {lidar.turn_hz}; must be at least lidar.rate_hz, "
                f"{lidar.rate_hz}, the number of sweeps that are used"
            )

    def parameters(self) -> dict[str, Any]:
        """The robot as a shard depends on it: nested mappings of numbers."""
        values = asdict(self)
        defaults = {f.name: f.default for f in fields(LidarSpec) if f.name in _LATER_FIELDS}
        values["lidar"] = {k: v for k, v in values["lidar"].items() if defaults.get(k, ...) != v}
        return values

    def with_lidar(self, lidar: Lidar) -> RobotSpec:
        """The robot with another lidar in the place of its own."""
        new = {f.name: getattr(lidar, f.name) for f in fields(Lidar)}
        return replace(self, lidar=replace(self.lidar, **new))

    def circle_at(self, height_m: float) -> tuple[float, float] | None:
        """x and radius [m] of the circle that a level scan at this height meets; None if it passes over."""
        if self.chassis.top_z_m < height_m <= self.size_m[2]:
            return self.lidar.x_m, self.lidar.cap_radius_m
        if self.chassis.bottom_z_m <= height_m <= self.chassis.top_z_m:
            return self.chassis.centre_x_m, self.chassis.radius_m
        return None

    def wheel_speeds(self, speed_mps: float, turn_rate_radps: float) -> tuple[float, float]:
        """Left and right wheel speed [rad/s] of a twist, scaled down together to the robot's limits."""
        turn_rate_radps = max(-self.max_turn_rate_radps, min(self.max_turn_rate_radps, turn_rate_radps))
        half_track_m = 0.5 * self.wheels.track_m
        limit_radps = self.max_speed_mps / self.wheels.radius_m
        left = (speed_mps - half_track_m * turn_rate_radps) / self.wheels.radius_m
        right = (speed_mps + half_track_m * turn_rate_radps) / self.wheels.radius_m
        scale = min(1.0, limit_radps / max(abs(left), abs(right), 1e-9))
        return left * scale, right * scale


def _numbers(values: Mapping[str, Any], parent: str = "") -> Iterator[tuple[str, float]]:
    """The keys of a robot file, such as `lidar.rate_hz`, with their numbers; a list has its key for each."""
    for key, value in values.items():
        if isinstance(value, Mapping):
            yield from _numbers(value, f"{parent}{key}.")
        elif not isinstance(value, str):
            yield from ((f"{parent}{key}", number) for number in np.atleast_1d(value).tolist())


def noisy_ranges(ranges_m: Array, spec: LidarSpec, *, rng: np.random.Generator) -> Array:
    """(B,) [m] as the sensor reports them: inf where there is no echo or it is out of the sensor's range."""
    # Normal in the range, Bernoulli for a lost echo; both always drawn, so that a beam's noise does not
    # depend on what the other beams hit.
    noise = spec.noise
    normal = rng.standard_normal(ranges_m.shape[0])
    lost = rng.random(ranges_m.shape[0]) < noise.dropout
    finite = np.where(np.isfinite(ranges_m), ranges_m, 0.0)
    measured = finite + normal * np.hypot(noise.sigma_m, noise.sigma_ratio * finite)
    if noise.step_m > 0.0:
        measured = np.round(measured / noise.step_m) * noise.step_m
    heard = np.isfinite(ranges_m) & ~lost & (measured >= spec.range_min_m) & (measured <= spec.range_max_m)
    return np.where(heard, measured, np.inf)


def beam_bearings(spec: LidarSpec) -> Array:
    """(B,) [rad] counter-clockwise: from straight ahead, or from the right end of the field of view."""
    if spec.sees_all_round():
        return np.arange(spec.beams, dtype=np.float64) * (_TURN_RAD / spec.beams)
    return spec.step_rad() * (np.arange(spec.beams, dtype=np.float64) - 0.5 * (spec.beams - 1))
