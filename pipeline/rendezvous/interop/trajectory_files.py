"""Files of poses over time: trajectories in TUM's format, and Kümmerle's relations."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from rendezvous.errors import LogError
from rendezvous.geometry.se2 import Array
from rendezvous.interop.given_file import given_bytes
from rendezvous.recorded.error import Relations

_TUM = "a trajectory in TUM's format: stamp x y z qx qy qz qw"
_RELATIONS = "Kümmerle's relations: stamp stamp x y z roll pitch yaw"


def tum_bytes(t_s: Array, poses: Array) -> bytes:
    """Poses (N, 3) at times (N,) as lines `stamp x y z qx qy qz qw`."""
    half = 0.5 * poses[:, 2]
    return "".join(
        f"{t:.6f} {x:.6f} {y:.6f} 0 0 0 {s:.9f} {c:.9f}\n"
        for t, (x, y, _), s, c in zip(t_s, poses, np.sin(half), np.cos(half), strict=True)
    ).encode()


def read_tum(path: Path) -> tuple[Array, Array]:
    """(N,) stamps and (N, 3) poses of a TUM file, in order of time.

    Raises:
        LogError: it cannot be read, or a line has other fields.
    """
    rows = _rows(path, 8, _TUM)
    qx, qy, qz, qw = rows[:, 4:].T
    yaw = np.arctan2(2.0 * (qw * qz + qx * qy), 1.0 - 2.0 * (qy * qy + qz * qz))
    order = np.argsort(rows[:, 0], kind="stable")
    return rows[order, 0], np.column_stack([rows[:, 1:3], yaw])[order]


def read_relations(path: Path) -> Relations:
    """The relations in a file.

    Raises:
        LogError: it cannot be read, or a line has other fields.
    """
    rows = _rows(path, 8, _RELATIONS)
    return Relations(stamps_s=rows[:, :2], motions=rows[:, [2, 3, 7]])


def _rows(path: Path, fields: int, right: str) -> Array:
    try:
        text = given_bytes(path).decode()
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or "not text"
        raise LogError(f"{path}: {reason.lower()}; must be {right}") from error
    rows = []
    for number, line in enumerate(text.splitlines(), start=1):
        words = line.split()
        if not words or words[0].startswith("#"):
            continue
        try:
            values = [float(word) for word in words]
        except ValueError:
            values = []
        if len(values) != fields or not all(map(math.isfinite, values)):
            raise LogError(f"{path}:{number}: {line.strip()!r:.60}; must be {right}")
        rows.append(values)
    if not rows:
        raise LogError(f"{path}: no lines; must be {right}")
    return np.array(rows)
