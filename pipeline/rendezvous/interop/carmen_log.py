"""Laser logs of CARMEN: text, a message a line (`.log`, `.clf`), as it is or gzipped.

Read are `FLASER` (n ranges, x y yaw of the laser, x y yaw of odometry, stamp), `ROBOTLASER1` (which has the
field of view, the resolution and the largest range before them), and of `PARAM` where the laser is and how
far it reaches. In a log as the robot wrote it the laser's pose is odometry's with a fixed offset. Logs that
went through a SLAM have corrected poses: there the two differ, or both are corrected, which GMapping's `NEFF`
lines give away.
"""

from __future__ import annotations

import math
import zlib
from collections import Counter
from dataclasses import dataclass, field
from enum import StrEnum
from pathlib import Path

import numpy as np

from rendezvous.errors import LogError
from rendezvous.geometry.se2 import Array, wrap_angle
from rendezvous.interop.given_file import given_bytes
from rendezvous.recorded.laser_log import LaserLog
from rendezvous.recorded.repair import no_echo_above, readings, rising_stamps

RIGHT = "a CARMEN log with FLASER or ROBOTLASER1 lines"
_MOST_BYTES = 1 << 31
_RIGID_M = 2e-3  # poses of laser and odometry farther from one fixed offset are of two sources


class PosesOf(StrEnum):
    """What the poses in a log are."""

    AUTO = "auto"
    ODOMETRY = "odometry"
    REFERENCE = "reference"


@dataclass(slots=True, kw_only=True)
class _Scans:
    """Lines read so far."""

    ranges_m: list[list[float]] = field(default_factory=list)
    laser: list[list[float]] = field(default_factory=list)
    robot: list[list[float]] = field(default_factory=list)
    stamps_s: list[float] = field(default_factory=list)
    first_rad: float | None = None
    step_rad: float | None = None
    range_max_m: float = math.inf
    laser_x_m: float = 0.0
    filtered: bool = False
    damaged: int = 0


def read_carmen_log(
    path: Path, *, poses: PosesOf = PosesOf.AUTO, range_max_m: float | None = None
) -> LaserLog:
    """Read the front laser of a CARMEN log.

    Args:
        path: the file.
        poses: what the poses in it are; by default that is found out.
        range_max_m: from there on a reading is no echo; by default that is found out.

    Raises:
        LogError: it cannot be read, or holds no scans.
    """
    scans = _Scans()
    for line in _text(path).splitlines():
        _read_line(line, scans)
    if not scans.ranges_m:
        raise LogError(f"{path}: no FLASER or ROBOTLASER1 line with ranges; must be {RIGHT}")
    ranges_m, notes = _same_beams(scans.ranges_m)
    if scans.damaged:
        notes.append(f"{scans.damaged} damaged lines are left out")
    kept, t_s, jumps = rising_stamps(np.array(scans.stamps_s))
    most_m = min(no_echo_above(ranges_m), scans.range_max_m) if range_max_m is None else range_max_m
    first_rad, step_rad = _geometry(ranges_m.shape[1], scans)
    laser, robot = np.array(scans.laser)[kept], np.array(scans.robot)[kept]
    odometry, reference, lidar_xy_m = _sources(laser, robot, scans, poses)
    return LaserLog(
        source=str(path),
        t_s=t_s,
        ranges_m=readings(ranges_m[kept], range_min_m=0.0, range_max_m=most_m),
        bearings_rad=first_rad + step_rad * np.arange(ranges_m.shape[1], dtype=np.float64),
        lidar_xy_m=lidar_xy_m,
        range_max_m=most_m if math.isfinite(most_m) else float(np.nanmax(ranges_m)),
        odometry=odometry,
        odometry_start=odometry,
        reference=reference,
        notes=tuple(notes + jumps),
    )


def _text(path: Path) -> str:
    """The file's text, unzipped."""
    try:
        data = given_bytes(path, most_bytes=_MOST_BYTES)
        if data.startswith(b"\x1f\x8b"):
            unzip = zlib.decompressobj(wbits=31)
            data = unzip.decompress(data, _MOST_BYTES)
            if not unzip.eof:
                raise LogError(f"{path}: damaged (the end of the gzipped text is missing); must be {RIGHT}")
    except (OSError, zlib.error) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise LogError(f"{path}: {reason.lower()}; must be {RIGHT}") from error
    return data.decode("ascii", errors="replace")


def _read_line(line: str, scans: _Scans) -> None:
    words = line.split()
    if not words:
        return
    try:
        if words[0] == "FLASER":
            _add(scans, words[2:], int(words[1]))
        elif words[0] == "ROBOTLASER1":
            # laser_type start_angle field_of_view angular_resolution maximum_range accuracy remission_mode
            count = int(words[8])
            after = words[9 + count :]
            _add(scans, words[9 : 9 + count] + after[1 + int(after[0]) :], count, stamp=11)
            scans.first_rad, scans.step_rad = float(words[2]), float(words[4])
            scans.range_max_m = float(words[5])
        elif words[0] == "PARAM" and len(words) > 2:
            _read_parameter(words[1], words[2], scans)
        elif words[0] == "NEFF":
            scans.filtered = True
    except (ValueError, IndexError):
        scans.damaged += words[0] in ("FLASER", "ROBOTLASER1")


def _add(scans: _Scans, words: list[str], count: int, *, stamp: int = 6) -> None:
    """Add a scan from its ranges and what follows: the poses of laser and robot, and a stamp after these."""
    numbers = [float(word) for word in words[: count + 6]]
    poses, stamp_s = numbers[count:], float(words[count + stamp])
    if count < 1 or len(poses) < 6 or not all(map(math.isfinite, poses)):
        raise ValueError
    scans.ranges_m.append(numbers[:count])
    scans.laser.append(poses[:3])
    scans.robot.append(poses[3:])
    scans.stamps_s.append(stamp_s)


def _read_parameter(name: str, value: str, scans: _Scans) -> None:
    if name == "robot_frontlaser_offset":
        scans.laser_x_m = float(value)
    elif name in ("robot_front_laser_max", "laser_front_laser_max"):
        scans.range_max_m = float(value)


def _same_beams(scans: list[list[float]]) -> tuple[Array, list[str]]:
    """(N, B) ranges, and what was done; a scan of another number of beams than most has no measurements."""
    beams, count = Counter(map(len, scans)).most_common(1)[0]
    ranges_m = np.full((len(scans), beams), np.nan)
    for row, scan in zip(ranges_m, scans, strict=True):
        if len(scan) == beams:
            row[:] = scan
    others = len(scans) - count
    return ranges_m, [f"{others} scans of other than {beams} beams are taken as empty"] if others else []


def _geometry(beams: int, scans: _Scans) -> tuple[float, float]:
    """Bearing of the first beam and the step to the next [rad].

    `FLASER` does not say: a SICK LMS looks from -90° on in steps of 180° / n, and where n is odd the last
    beam is at +90°; one of 401 beams or less than 100 would be another scanner, of 180° too.
    """
    if scans.first_rad is not None and scans.step_rad:
        return scans.first_rad, scans.step_rad
    return -0.5 * math.pi, math.pi / (beams - beams % 2 if beams > 1 else 1)


def _sources(
    laser: Array, robot: Array, scans: _Scans, poses: PosesOf
) -> tuple[Array | None, Array | None, tuple[float, float]]:
    """Odometry, reference (either of the robot) and the lidar's place on it."""
    offset = _fixed_offset(laser, robot)
    if offset is not None:
        reference = poses is PosesOf.REFERENCE or (poses is PosesOf.AUTO and scans.filtered)
        return (None, robot, offset) if reference else (robot, None, offset)
    lidar_xy_m = (scans.laser_x_m, 0.0)
    corrected = laser.copy()
    corrected[:, 0] -= scans.laser_x_m * np.cos(laser[:, 2])
    corrected[:, 1] -= scans.laser_x_m * np.sin(laser[:, 2])
    if poses is PosesOf.ODOMETRY:
        return robot, None, lidar_xy_m
    return robot, corrected, lidar_xy_m


def _fixed_offset(laser: Array, robot: Array) -> tuple[float, float] | None:
    """Where the laser is on the robot if that is the same in all scans, else None."""
    c, s = np.cos(robot[:, 2]), np.sin(robot[:, 2])
    dx, dy = (laser - robot)[:, :2].T
    offsets = np.stack([c * dx + s * dy, -s * dx + c * dy], axis=1)
    offset = np.median(offsets, axis=0)
    turned = max(abs(wrap_angle(float(a))) for a in laser[:, 2] - robot[:, 2])
    if np.abs(offsets - offset).max() > _RIGID_M or turned > _RIGID_M:
        return None
    return float(offset[0]), float(offset[1])
