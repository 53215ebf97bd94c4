"""The odometry that SLAM gets: as recorded, or the reference's motion with drawn noise."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rendezvous.errors import require_within
from rendezvous.geometry.se2 import Array
from rendezvous.recorded.laser_log import LaserLog
from rendezvous.slam.slam import compose, relative


@dataclass(frozen=True, slots=True, kw_only=True)
class DrawnOdometry:
    """Noise of the odometry drawn for logs that recorded none: sigmas of one step from scan to scan."""

    along: float = 0.03  # of the way travelled, along and across it
    yaw_rad_per_m: float = 0.02
    yaw_per_rad: float = 0.02  # of the angle turned

    def __post_init__(self) -> None:
        require_within(self, along=(0, 1), yaw_rad_per_m=(0, 1), yaw_per_rad=(0, 1))


def odometry_of(
    log: LaserLog, order: NDArray[np.int64], noise: DrawnOdometry, *, rng: np.random.Generator
) -> Array:
    """(N, 2, 3) poses in one frame as each of these scans began and ended, in the order given.

    As recorded where the log has odometry, else drawn.
    """
    if log.odometry is not None and log.odometry_start is not None:
        return np.stack([log.odometry_start[order], log.odometry[order]], axis=1)
    assert log.reference is not None, "a log has odometry or a reference"
    drawn = drawn_odometry(log.reference[order], noise, rng=rng)
    return np.stack([drawn, drawn], axis=1)


def drawn_odometry(reference: Array, noise: DrawnOdometry, *, rng: np.random.Generator) -> Array:
    """(N, 3) the reference (N, 3) as wheels would have measured it.

    Each step is off by normal draws: in x and y by `along` of its length, in yaw by what length and turn add.
    """
    draws = rng.standard_normal((len(reference) - 1, 4))
    poses = [reference[0]]
    for before, after, draw in zip(reference[:-1], reference[1:], draws, strict=True):
        step = relative(before, after)
        step[2] = np.remainder(step[2] + np.pi, 2.0 * np.pi) - np.pi
        length_m = float(np.hypot(step[0], step[1]))
        off = np.array(
            [
                noise.along * length_m * draw[0],
                noise.along * length_m * draw[1],
                noise.yaw_rad_per_m * length_m * draw[2] + noise.yaw_per_rad * abs(step[2]) * draw[3],
            ]
        )
        poses.append(compose(poses[-1], step + off))
    return np.array(poses)
