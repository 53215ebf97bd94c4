"""Where two stretches of one log come within sight of each other, as if two robots had met there."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rendezvous.errors import ConfigError
from rendezvous.geometry.se2 import Array
from rendezvous.recorded.error import motions_between
from rendezvous.recorded.laser_log import LaserLog

_BREAK_M, _BREAK_STEPS = 2.0, 5.0  # a longer step, or one of so many usual ones, is no drive but a jump
_HALF_WIDTH_M = 0.15  # the seen robot's; the beams that pass so close to its middle must go beyond it


@dataclass(frozen=True, slots=True, kw_only=True)
class Meeting:
    """Two stretches at whose ends robot 0 sees robot 1."""

    # scans_0, scans_1: indices into the log in the order of driving; falling where it is played backwards.
    scans_0: NDArray[np.int64]
    scans_1: NDArray[np.int64]
    T_r0_r1: Array  # (3,) true pose of robot 1 as seen from robot 0


@dataclass(frozen=True, slots=True, kw_only=True)
class Stretches:
    """What is drawn for a meeting."""

    length_m: tuple[float, float]  # bounds of the way that each robot has come, drawn log-uniformly
    distance_m: tuple[float, float]  # bounds of the distance at which they meet

    def __post_init__(self) -> None:
        for name in ("length_m", "distance_m"):
            low, high = getattr(self, name)
            if not 0.0 < low <= high:
                raise ConfigError(f"Stretches: {name} is [{low}, {high}]; must be two rising lengths above 0")


def driven_parts(log: LaserLog) -> NDArray[np.int64]:
    """(N,) number of the part that each scan belongs to: parts end where the poses jump."""
    steps_m = np.hypot(*np.diff(log.path()[:, :2], axis=0).T)
    usual_m = float(np.median(steps_m[steps_m > 0.0])) if (steps_m > 0.0).any() else 0.0
    jumps = steps_m > max(_BREAK_M, _BREAK_STEPS * usual_m)
    return np.concatenate([[0], np.cumsum(jumps)]).astype(np.int64)


def sees(log: LaserLog, scan: int, p_r: Array) -> NDArray[np.bool_]:
    """(M,) whether this scan reaches beyond points (M, 2) in the robot's frame, which a robot may stand at.

    All beams that pass within a robot's half width must go farther; where there is no measurement, or the
    lidar does not look, nothing is seen.
    """
    x, y = (p_r - np.array(log.lidar_xy_m)).T
    distance_m, bearing = np.hypot(x, y), np.arctan2(y, x)
    step = float(np.abs(np.median(np.diff(log.bearings_rad)))) if len(log.bearings_rad) > 1 else math.pi
    half = np.maximum(np.arctan2(_HALF_WIDTH_M, distance_m), step)
    off = np.abs(np.remainder(log.bearings_rad - bearing[:, None] + np.pi, 2.0 * np.pi) - np.pi)
    near = off <= half[:, None]
    beyond = log.ranges_m[scan] > distance_m[:, None]  # NaN is not
    on_both_sides = (off <= step).sum(axis=1) >= 2
    return on_both_sides & (beyond | ~near).all(axis=1)


def draw_meeting(
    log: LaserLog,
    parts: NDArray[np.int64],
    stretches: Stretches,
    *,
    relations: tuple[NDArray[np.int64], Array] | None,
    rng: np.random.Generator,
) -> Meeting | None:
    """Draw where robot 0 stands, what it sees, and the two stretches that end there.

    Args:
        log: its path is where the robots are; must have a reference.
        parts: of `driven_parts`.
        stretches: what to draw.
        relations: (R, 2) pairs of scans and (R, 3) the motion between them: robots meet at such pairs only.
        rng: of this meeting.

    Returns:
        None if the draw came to nothing: no one in sight, or too little path before the meeting.
    """
    first = int(rng.integers(len(log)))
    candidates, motions = _others(log, first, relations)
    distances_m = np.hypot(motions[:, 0], motions[:, 1])
    near = (distances_m >= stretches.distance_m[0]) & (distances_m <= stretches.distance_m[1])
    candidates, motions = candidates[near], motions[near]
    seen = sees(log, first, motions[:, :2]) if len(candidates) else np.zeros(0, np.bool_)
    if not seen.any():
        return None
    chosen = int(rng.choice(np.flatnonzero(seen)))
    low_m, high_m = np.log(stretches.length_m)
    lengths_m = np.exp(rng.uniform(low_m, high_m, 2))
    ways = _apart(log, parts, (first, int(candidates[chosen])), lengths_m)
    if not ways:
        return None
    scans_0, scans_1 = ways[int(rng.integers(len(ways)))]
    return Meeting(scans_0=scans_0, scans_1=scans_1, T_r0_r1=motions[chosen])


def _others(
    log: LaserLog, first: int, relations: tuple[NDArray[np.int64], Array] | None
) -> tuple[NDArray[np.int64], Array]:
    """Scans at which robot 1 may be, and its poses as seen from the first."""
    if relations is not None:
        scans, motions = relations
        known = scans[:, 0] == first
        return scans[known, 1], motions[known]
    path = log.path()
    others = np.flatnonzero(np.arange(len(log)) != first)
    return others, motions_between(np.broadcast_to(path[first], (len(others), 3)), path[others])


def _apart(
    log: LaserLog, parts: NDArray[np.int64], ends: tuple[int, int], lengths_m: Array
) -> list[tuple[NDArray[np.int64], NDArray[np.int64]]]:
    """The pairs of stretches of these lengths that end at these scans and share none."""
    travelled_m = log.travelled_m()
    of_each = [
        [
            way
            for direction in (-1, 1)
            if (way := _stretch(travelled_m, parts, end, float(length_m), direction)) is not None
        ]
        for end, length_m in zip(ends, lengths_m, strict=True)
    ]
    return [
        (one, other)
        for one in of_each[0]
        for other in of_each[1]
        if max(one) < min(other) or max(other) < min(one)
    ]


def _stretch(
    travelled_m: Array, parts: NDArray[np.int64], end: int, length_m: float, direction: int
) -> NDArray[np.int64] | None:
    """The scans of a stretch up to its end, come from lower (-1) or higher (1) scans; None if it is cut."""
    if direction < 0:
        start = int(np.searchsorted(travelled_m, travelled_m[end] - length_m, side="right")) - 1
    else:
        start = int(np.searchsorted(travelled_m, travelled_m[end] + length_m))
    if not 0 <= start < len(travelled_m) or parts[start] != parts[end] or start == end:
        return None
    return np.arange(start, end - direction, -direction, dtype=np.int64)
