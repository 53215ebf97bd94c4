"""SLAM over a recorded laser log: its map, the robot's path, and how far that is from a reference."""

from __future__ import annotations

import time
from dataclasses import asdict, dataclass, replace
from enum import StrEnum
from pathlib import Path
from typing import Any

import numpy as np

from rendezvous.alignment.window import WINDOW_CELL_M
from rendezvous.baselines.correlative import CorrelativeSearch
from rendezvous.errors import LogError
from rendezvous.geometry.se2 import Array
from rendezvous.interop.g2o import g2o_bytes
from rendezvous.interop.ros_map import ros_map_bytes
from rendezvous.interop.trajectory_files import read_relations, tum_bytes
from rendezvous.loop_closure.mapped import ClosedMap, LoopCounts, map_with_loops
from rendezvous.loop_closure.matching import LoopWindow
from rendezvous.recorded.error import (
    PathError,
    Relations,
    reference_error,
    relation_error,
    segment_error,
    wrapped,
)
from rendezvous.recorded.laser_log import LaserLog
from rendezvous.recorded.mapped import LidarModel, Mapped, map_scans
from rendezvous.recorded.odometry import DrawnOdometry, odometry_of
from rendezvous.seeds import stream
from rendezvous.slam.slam import SlamParameters
from rendezvous.stages.weights.estimators import selected_matcher, trained
from rendezvous.store.disk import Disk
from rendezvous.store.records import json_bytes

_SEGMENTS_M = (20.0, 50.0)
_SEARCH_CELL_M = 0.1  # cells of the windows that correlative search gets


class LoopSearch(StrEnum):
    """What recognises a place that was seen before."""

    CORRELATIVE = "correlative"
    MATCHER = "matcher"


_TITLES = {LoopSearch.CORRELATIVE: "correlative search", LoopSearch.MATCHER: "the matcher"}


@dataclass(frozen=True, slots=True, kw_only=True)
class SlamRun:
    """A log after SLAM."""

    log: LaserLog
    mapped: Mapped
    errors: dict[str, PathError]  # by what they were measured against
    seconds: float
    closed: ClosedMap | None = None  # what loop closure did; None without it
    loop_search: str = ""  # the method that compared places

    def lines(self) -> list[str]:
        """What happened, for people."""
        log, grid = self.log, self.mapped.grid
        height, width = (cells * grid.resolution_m for cells in grid.cells.shape)
        recorded = log.t_s[-1] - log.t_s[0]
        drawn = "recorded" if log.odometry is not None else "drawn"
        lines = [f"note: {note}" for note in log.notes]
        lines.append(
            f"{len(log)} scans of {len(log.bearings_rad)} beams over {log.travelled_m()[-1]:.1f} m of path, "
            f"odometry {drawn}; map {width:.1f} x {height:.1f} m"
        )
        if self.closed is not None:
            counts = self.closed.counts
            lines.append(
                f"loops by {self.loop_search}: {counts.closed} closed, {counts.rejected} rejected as false, "
                f"of {counts.compared} comparisons of {counts.submaps} submaps"
            )
        lines += [f"{name}: {_shown(error)}" for name, error in self.errors.items()]
        rate = len(log) / self.seconds
        lines.append(f"{self.seconds:.1f} s, {rate:.0f} scans a second ({recorded:.0f} s were recorded)")
        return lines

    def record(self) -> dict[str, Any]:
        """The same as JSON."""
        log = self.log
        return {
            "log": log.source,
            "notes": list(log.notes),
            "scans": len(log),
            "beams": len(log.bearings_rad),
            "path_m": float(log.travelled_m()[-1]),
            "odometry": "recorded" if log.odometry is not None else "drawn",
            "loops": None if self.closed is None else self._loops(self.closed.counts),
            "seconds": self.seconds,
            "errors": {name: error.to_json() for name, error in self.errors.items()},
        }

    def _loops(self, counts: LoopCounts) -> dict[str, Any]:
        return {"search": self.loop_search, **asdict(counts)}


def _shown(error: PathError) -> str:
    t, r = error.translation_m, np.degrees(error.rotation_rad)
    return (
        f"{t.mean():.3f} ± {t.std():.3f} m (median {np.median(t):.3f}), {r.mean():.2f} ± {r.std():.2f}° "
        f"(median {np.median(r):.2f}), {len(t)} compared"
    )


def run_slam(
    log: LaserLog,
    *,
    relations: Path | None,
    parameters: SlamParameters,
    lidar: LidarModel,
    noise: DrawnOdometry,
    seed: int,
    loops: LoopSearch | None = LoopSearch.CORRELATIVE,
) -> SlamRun:
    """Map a whole log and measure the path; noise and seed are those of odometry drawn for a log without.

    Raises:
        LogError: the relations cannot be read, or none lies between two scans of the log.
        SetupError, StoreError, ConfigError: the matcher is to find loops and cannot be loaded.
    """
    known = None if relations is None else read_relations(relations)
    order = np.arange(len(log), dtype=np.int64)
    odometry = odometry_of(log, order, noise, rng=stream(seed, "slam", "odometry"))
    window = None if loops is None else _loop_window(loops)
    started_s = time.perf_counter()
    closed = None
    if window is None:
        mapped = map_scans(log, order, odometry, lidar=lidar, parameters=parameters)
    else:
        closed = map_with_loops(log, order, odometry, lidar=lidar, parameters=parameters, window=window)
        mapped = closed.mapped
    seconds = time.perf_counter() - started_s
    errors = _reference_errors(log, mapped.poses)
    if known is not None:
        errors |= _relation_errors(log, mapped.poses, odometry[:, 1], known, where=f"{relations}")
    return SlamRun(
        log=log,
        mapped=mapped,
        errors=errors,
        seconds=seconds,
        closed=closed,
        loop_search="" if loops is None else _TITLES[loops],
    )


def _loop_window(loops: LoopSearch) -> LoopWindow:
    """What compares submaps."""
    if loops is LoopSearch.CORRELATIVE:
        return LoopWindow(searching=lambda search: CorrelativeSearch(search=search), cell_m=_SEARCH_CELL_M)
    estimator: Any = trained(selected_matcher(), threads=1).estimator  # a frozen record
    return LoopWindow(searching=lambda search: replace(estimator, search=search), cell_m=WINDOW_CELL_M)


def _reference_errors(log: LaserLog, poses: Array) -> dict[str, PathError]:
    if log.reference is None:
        return {}
    errors = {"reference, whole path": reference_error(poses, log.reference)}
    for length_m in _SEGMENTS_M:
        error = segment_error(poses, log.reference, log.travelled_m(), length_m)
        if error is not None:
            errors[f"reference, after {length_m:.0f} m"] = error
    return errors


def _relation_errors(
    log: LaserLog, poses: Array, odometry: Array, known: Relations, *, where: str
) -> dict[str, PathError]:
    errors = {}
    for name, path in (("relations", poses), ("odometry by relations", odometry)):
        error = relation_error(log.t_s, path, known)
        if error is None:
            raise LogError(
                f"{where}: none of its {len(known.motions)} relations lies between two scans of "
                f"{log.source}; must be of the same log"
            )
        errors[name] = error
    apart = relation_error(log.t_s, poses, known, told_apart=True)
    if apart is not None and len(apart.translation_m) < len(errors["relations"].translation_m):
        errors["relations of scans told apart"] = apart
    return errors


def write_slam(run: SlamRun, out: Path) -> list[Path]:
    """Write `map.yaml`, `map.pgm`, `trajectory.tum`, with loops `graph.g2o`, and `slam.json` last.

    Raises:
        StoreError: the folder cannot be written.
    """
    image, header = ros_map_bytes(run.mapped.grid, "map.pgm")
    poses = run.mapped.poses.copy()
    poses[:, 2] = wrapped(poses[:, 2])
    files = {"map.pgm": image, "map.yaml": header, "trajectory.tum": tum_bytes(run.log.t_s, poses)}
    if run.closed is not None:
        files["graph.g2o"] = g2o_bytes(run.closed.vertices, run.closed.graph)
    files["slam.json"] = json_bytes(run.record())
    disk = Disk(str(out))
    for name, data in files.items():
        disk.write(name, data)
    return [out / name for name in files]
