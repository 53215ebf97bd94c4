"""The error of a path: against reference poses, or against relations between pairs of them.

The metric of relations is that of Kümmerle et al., *On Measuring the Accuracy of SLAM Algorithms*, Autonomous
Robots 27 (2009): for each relation from pose i to pose j, the motion by which the estimated one differs from
it. Relations are local, so one wrong turn does not spoil all that follows.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rendezvous.geometry.se2 import Array

_SAME_SCAN_S = 0.02  # logs round their stamps
_BIN_S = 0.01
_TRIED = 400  # stamps of relations from which the shift of a log's clock is found


@dataclass(frozen=True, slots=True, kw_only=True)
class Relations:
    """Known motions between moments of a log."""

    stamps_s: Array  # (R, 2) from when, to when
    motions: Array  # (R, 3) x, y [m], yaw [rad] of the second pose as seen from the first


@dataclass(frozen=True, slots=True, kw_only=True)
class PathError:
    """Errors of translation [m] and rotation [rad], (R,) each."""

    translation_m: Array
    rotation_rad: Array

    def to_json(self) -> dict[str, float | int]:
        """Count, mean, standard deviation, median and maximum of both."""
        record: dict[str, float | int] = {"count": len(self.translation_m)}
        for name, unit, values in (
            ("translation", "m", self.translation_m),
            ("rotation", "rad", self.rotation_rad),
        ):
            record |= {
                f"{name}_mean_{unit}": float(values.mean()),
                f"{name}_std_{unit}": float(values.std()),
                f"{name}_median_{unit}": float(np.median(values)),
                f"{name}_max_{unit}": float(values.max()),
            }
        return record


def motions_between(before: Array, after: Array) -> Array:
    """(R, 3) poses `after` (R, 3) as seen from `before` (R, 3); yaw in [-pi, pi)."""
    c, s = np.cos(before[:, 2]), np.sin(before[:, 2])
    dx, dy = (after - before)[:, :2].T
    return np.stack([c * dx + s * dy, -s * dx + c * dy, wrapped(after[:, 2] - before[:, 2])], axis=1)


def wrapped(angles_rad: Array) -> Array:
    """The same angles in [-pi, pi)."""
    return np.remainder(angles_rad + np.pi, 2.0 * np.pi) - np.pi


def error_of(estimated: Array, true: Array) -> PathError:
    """How far motions (R, 3) are from the true ones."""
    off = motions_between(true, estimated)
    return PathError(translation_m=np.hypot(off[:, 0], off[:, 1]), rotation_rad=np.abs(off[:, 2]))


def reference_error(poses: Array, reference: Array) -> PathError:
    """The error of a path (N, 3) after the rigid motion that brings it closest to the reference (N, 3)."""
    centre, centre_w = poses[:, :2].mean(axis=0), reference[:, :2].mean(axis=0)
    p, q = poses[:, :2] - centre, reference[:, :2] - centre_w
    turn = np.arctan2((p[:, 0] * q[:, 1] - p[:, 1] * q[:, 0]).sum(), (p * q).sum())
    c, s = np.cos(turn), np.sin(turn)
    moved = p @ np.array([[c, s], [-s, c]]) + centre_w
    return error_of(np.column_stack([moved, poses[:, 2] + turn]), reference)


def segment_error(poses: Array, reference: Array, travelled_m: Array, length_m: float) -> PathError | None:
    """The error of the motion over every stretch of path of this length, None if the path is shorter."""
    ends = np.searchsorted(travelled_m, travelled_m + length_m)
    starts = np.flatnonzero(ends < len(travelled_m))
    if not len(starts):
        return None
    ends = ends[starts]
    return error_of(
        motions_between(poses[starts], poses[ends]), motions_between(reference[starts], reference[ends])
    )


def relation_error(
    t_s: Array, poses: Array, relations: Relations, *, told_apart: bool = False
) -> PathError | None:
    """The error of a path (N, 3) by relations; None if there is none between two of its scans.

    `told_apart` leaves out relations with a stamp that another one, closer to the same scan, shows to be of a
    scan that the log lacks.
    """
    pairs, motions = related_scans(t_s, relations, told_apart=told_apart)
    if not len(pairs):
        return None
    return error_of(motions_between(poses[pairs[:, 0]], poses[pairs[:, 1]]), motions)


def related_scans(
    t_s: Array, relations: Relations, *, told_apart: bool = False
) -> tuple[NDArray[np.int64], Array]:
    """(R, 2) pairs of scans between which there are relations, and (R, 3) their motions.

    If no stamp fits, the log's clock started at zero: the shift that fits most stamps is taken.
    """
    stamps_s = relations.stamps_s.ravel()
    scans = scans_at(t_s, stamps_s)
    if not (scans >= 0).any():
        stamps_s = stamps_s - _shift_s(t_s, stamps_s)
        scans = scans_at(t_s, stamps_s)
    if told_apart:
        off_s = np.where(scans >= 0, np.abs(stamps_s - t_s[scans]), np.inf)
        nearest_s = np.full(len(t_s), np.inf)
        np.minimum.at(nearest_s, scans[scans >= 0], off_s[scans >= 0])
        scans = np.where(off_s == nearest_s[scans], scans, -1)
    pairs = scans.reshape(-1, 2)
    known = (pairs >= 0).all(axis=1)
    return pairs[known], relations.motions[known]


def scans_at(t_s: Array, stamps_s: Array) -> NDArray[np.int64]:
    """(R,) index of the scan at each stamp, -1 where there is none."""
    after = np.clip(np.searchsorted(t_s, stamps_s), 1, len(t_s) - 1)
    nearest = np.where(stamps_s - t_s[after - 1] < t_s[after] - stamps_s, after - 1, after)
    return np.where(np.abs(t_s[nearest] - stamps_s) <= _SAME_SCAN_S, nearest, -1)


def _shift_s(t_s: Array, stamps_s: Array) -> float:
    """What to subtract from stamps to have most of them fall on scans."""
    tried = np.unique(stamps_s)[:: max(1, len(np.unique(stamps_s)) // _TRIED)]
    shifts = np.sort((tried[:, None] - t_s).ravel())
    within = np.searchsorted(shifts, shifts + _BIN_S) - np.arange(len(shifts))
    best = int(np.argmax(within))
    return float(np.median(shifts[best : best + within[best]]))
