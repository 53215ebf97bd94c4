"""SLAM over a log of 10 scans of 360 beams a second, with and without loop closure, on one core."""

from __future__ import annotations

import argparse
import time
from typing import Any

import numpy as np

from benchmarks.scene import default_config
from rendezvous.baselines.correlative import CorrelativeSearch
from rendezvous.geometry.se2 import Array
from rendezvous.loop_closure.mapped import map_with_loops
from rendezvous.loop_closure.matching import LoopWindow
from rendezvous.recorded.error import reference_error
from rendezvous.recorded.laser_log import LaserLog
from rendezvous.recorded.mapped import map_scans
from rendezvous.recorded.odometry import drawn_odometry
from rendezvous.seeds import stream
from rendezvous.simulation.rays import cast_rays, ray_scene

RATE_HZ, SPEED_MPS, BEAMS = 10.0, 0.5, 360
TARGET = 5.0  # times real time
_SIDE_M, _HALL_M, _LAPS = 24.0, 3.0, 2.2


def measure(options: argparse.Namespace) -> dict[str, Any]:
    """Scans a second of processor time, and how far the path is off."""
    section = default_config().replay
    log = _ring()
    assert log.reference is not None
    order = np.arange(len(log), dtype=np.int64)
    drawn = drawn_odometry(log.reference, section.odometry, rng=stream(0, "bench", "odometry"))
    odometry = np.stack([drawn, drawn], axis=1)
    window = LoopWindow(searching=lambda search: CorrelativeSearch(search=search), cell_m=0.1)
    given = {"lidar": section.lidar, "parameters": section.slam}
    ways: dict[str, Any] = {
        "without loops": lambda scans: map_scans(log, scans, odometry[scans], **given),
        "with loops": lambda scans: (
            map_with_loops(log, scans, odometry[scans], window=window, **given).mapped
        ),
    }
    results: dict[str, Any] = {"scans": len(log), "beams": BEAMS}
    for name, run in ways.items():
        run(order[: len(log) // 2 + 200])  # compiles: the first lap and a little more
        started_s = time.process_time()
        mapped = run(order)
        rate = len(log) / (time.process_time() - started_s)
        off_m = reference_error(mapped.poses, log.reference).translation_m
        results[name] = {
            "scans_per_s": round(rate),
            "times_real_time": round(rate / RATE_HZ, 1),
            "target": TARGET,
            "mean_error_m": round(float(off_m.mean()), 3),
        }
    return results


def _ring() -> LaserLog:
    """Twice around a ring of corridors with doors and cupboards, drawn by lot."""
    rng = stream(0, "bench", "ring")
    inner_m = _SIDE_M - _HALL_M
    boxes = [_box(0.0, 0.0, _SIDE_M, _SIDE_M), _box(_HALL_M, _HALL_M, inner_m, inner_m)]
    for along_m in np.arange(1.0, _SIDE_M - 2.0, 2.0):
        for turn in range(4):
            width_m, depth_m, at_m = (
                rng.uniform(0.3, 1.2),
                rng.uniform(0.1, 0.6),
                along_m + rng.uniform(0, 0.8),
            )
            corners = (at_m, 0.0, at_m + width_m, depth_m)
            boxes.append(_quarter_turns(_box(*corners), turn))
    scene = ray_scene(np.concatenate(boxes), np.empty((0, 3)))
    middle_m, length_m = 0.5 * _HALL_M, _SIDE_M - _HALL_M
    at_m = np.arange(2.0, _LAPS * 4.0 * length_m, SPEED_MPS / RATE_HZ)
    side, along = np.divmod(at_m, length_m)
    poses = np.empty((len(at_m), 3))
    for i, (turn, s) in enumerate(zip(side.astype(int), along, strict=True)):
        point = _quarter_turns(np.array([[middle_m + s, middle_m] * 2]), turn % 4)[0]
        # A metre before and after a corner the robot turns.
        poses[i] = (
            point[0],
            point[1],
            0.5 * np.pi * (turn + np.clip(0.5 * (s - length_m + 1.0), 0.0, 0.5) * 2.0),
        )
    bearings = np.deg2rad(np.arange(0.0, 360.0, 360.0 / BEAMS))
    ranges_m = np.array([cast_rays(scene, np.tile(p, (BEAMS, 1)), bearings, max_range_m=12.0) for p in poses])
    ranges_m += 0.01 * rng.standard_normal(ranges_m.shape)
    return LaserLog(
        source="ring", t_s=np.arange(len(poses)) / RATE_HZ, ranges_m=ranges_m, bearings_rad=bearings,
        lidar_xy_m=(0.0, 0.0), range_max_m=12.0, odometry=None, odometry_start=None, reference=poses,
    )  # fmt: skip


def _box(x0: float, y0: float, x1: float, y1: float) -> Array:
    """(4, 4) the sides of a rectangle."""
    ring = np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1], [x0, y0]])
    return np.hstack([ring[:-1], ring[1:]])


def _quarter_turns(segments: Array, count: int) -> Array:
    """Segments (S, 4) turned about the middle of the ring."""
    half_m = 0.5 * _SIDE_M
    for _ in range(count):
        x0, y0, x1, y1 = segments.T - half_m
        segments = np.column_stack([-y0, x0, -y1, x1]) + half_m
    return segments
