"""SLAM with loop closure over a ring of corridors."""

from __future__ import annotations

import gzip
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from rendezvous.baselines.correlative import CorrelativeSearch
from rendezvous.config.load import load_config
from rendezvous.geometry.se2 import SE2, Array
from rendezvous.interop.carmen_log import read_carmen_log
from rendezvous.interop.trajectory_files import read_relations
from rendezvous.loop_closure.mapped import ClosedMap, map_with_loops
from rendezvous.loop_closure.matching import LoopWindow
from rendezvous.recorded.error import error_of, motions_between, reference_error, relation_error
from rendezvous.recorded.laser_log import LaserLog
from rendezvous.recorded.mapped import LidarModel, map_scans
from rendezvous.recorded.odometry import DrawnOdometry, drawn_odometry
from rendezvous.slam.pose_graph import squared_errors
from tests.conftest import ROOT
from tests.loop_closure.building import driven_around, walls_m
from tests.recorded.drive import driven, laser_log

WINDOW = LoopWindow(searching=lambda search: CorrelativeSearch(search=search), cell_m=0.1)
PARAMETERS = load_config(ROOT / "stages.yaml").replay.slam


def odometry_of(log: LaserLog) -> Array:
    """Wheels that err in heading thrice as much as by default."""
    assert log.reference is not None
    noise = DrawnOdometry(yaw_rad_per_m=0.06)
    drawn = drawn_odometry(log.reference, noise, rng=np.random.default_rng(0))
    return np.stack([drawn, drawn], axis=1)


def closed_map(log: LaserLog, odometry: Array) -> ClosedMap:
    order = np.arange(len(log), dtype=np.int64)
    return map_with_loops(log, order, odometry, lidar=LidarModel(), parameters=PARAMETERS, window=WINDOW)


@pytest.fixture(scope="module")
def ring() -> tuple[LaserLog, ClosedMap]:
    log = driven_around(lidar_xy_m=(0.25, 0.1))
    return log, closed_map(log, odometry_of(log))


def test_the_ring_closes_and_the_path_is_better_than_without(ring: tuple[LaserLog, ClosedMap]) -> None:
    log, closed = ring
    assert log.reference is not None
    order = np.arange(len(log), dtype=np.int64)
    without = map_scans(log, order, odometry_of(log), lidar=LidarModel(), parameters=PARAMETERS)
    off_m, off_without_m = (
        reference_error(poses, log.reference).translation_m for poses in (closed.mapped.poses, without.poses)
    )
    assert off_m.max() < 0.04
    assert off_m.mean() < 0.6 * off_without_m.mean()
    assert closed.counts.closed >= 2
    assert closed.counts.compared >= closed.counts.closed + closed.counts.rejected


def test_the_map_is_drawn_from_the_corrected_path(ring: tuple[LaserLog, ClosedMap]) -> None:
    log, closed = ring
    assert log.reference is not None
    grid = closed.mapped.grid
    p_w = SE2.from_array(log.reference[0]) @ grid.cell_centres(grid.occupied())
    a, along = walls_m()[:, :2], walls_m()[:, 2:] - walls_m()[:, :2]
    t = ((p_w[:, None] - a) * along).sum(-1) / (along * along).sum(-1)
    nearest = a + np.clip(t, 0.0, 1.0)[..., None] * along
    off_m = np.linalg.norm(p_w[:, None] - nearest, axis=-1).min(axis=1)
    assert (off_m < 0.06).mean() > 0.97


def test_the_graph_is_that_of_the_robot_wherever_its_lidar_is(ring: tuple[LaserLog, ClosedMap]) -> None:
    log, closed = ring
    assert len(closed.vertices) == len(log) + closed.counts.submaps
    assert (closed.vertices[: len(log)] == closed.mapped.poses).all()
    ends = closed.graph.ends
    off = motions_between(closed.vertices[ends[:, 0]], closed.vertices[ends[:, 1]])
    error = error_of(off, closed.graph.motions)
    assert np.median(error.translation_m) < 0.01
    assert np.median(squared_errors(closed.vertices, closed.graph)) < 0.5
    assert (np.linalg.eigvalsh(closed.graph.information) > 0.0).all()


def test_the_same_log_gives_the_same_path(ring: tuple[LaserLog, ClosedMap]) -> None:
    log, closed = ring
    again = closed_map(log, odometry_of(log))
    assert (again.mapped.poses == closed.mapped.poses).all()
    assert again.counts == closed.counts


def test_logs_without_anything_to_close_are_mapped_as_without() -> None:
    drive = driven(scans=30)
    log = laser_log(drive)
    odometry = np.stack([drive.poses_w, drive.poses_w], axis=1)
    closed = closed_map(log, odometry)
    assert closed.counts.compared == 0
    error = error_of(
        motions_between(closed.mapped.poses[:-1], closed.mapped.poses[1:]),
        motions_between(drive.poses_w[:-1], drive.poses_w[1:]),
    )
    assert error.translation_m.max() < 0.03


def test_scans_without_a_measurement_follow_odometry() -> None:
    drive = driven()
    for empty in (slice(0, 5), slice(20, 30), slice(0, 60)):
        ranges_m = drive.ranges_m.copy()
        ranges_m[empty] = np.nan
        closed = closed_map(
            laser_log(drive, ranges_m=ranges_m), np.stack([drive.poses_w, drive.poses_w], axis=1)
        )
        assert reference_error(closed.mapped.poses, drive.poses_w).translation_m.max() < 0.05


@pytest.mark.parametrize("beyond_m", [60.0, 500.0])
def test_a_jump_of_odometry_leaves_both_sides_of_it_whole(beyond_m: float) -> None:
    drive = driven()
    odometry = np.stack([drive.poses_w, drive.poses_w], axis=1)
    odometry[30:, :, 0] += beyond_m
    poses = closed_map(laser_log(drive), odometry).mapped.poses
    for side in (slice(0, 30), slice(30, 60)):
        assert reference_error(poses[side], drive.poses_w[side]).translation_m.max() < 0.05
    assert poses[30, 0] - poses[29, 0] == pytest.approx(beyond_m, rel=0.05)


def test_two_scans_are_enough() -> None:
    drive = driven(scans=2)
    closed = closed_map(laser_log(drive), np.stack([drive.poses_w, drive.poses_w], axis=1))
    assert closed.counts.submaps == 1
    assert closed.mapped.poses.shape == (2, 3)


def raw_intel(real_data: Path) -> LaserLog:
    """Intel's log with the odometry as its robot recorded it."""
    logs = real_data / "logs"
    if not (logs / "intel_raw_odometry.json.gz").is_file():
        pytest.skip(f"no Intel log in {logs}")
    log = read_carmen_log(logs / "intel.log.gz")
    scans = json.loads(gzip.decompress((logs / "intel_raw_odometry.json.gz").read_bytes()))["map"]
    raw = np.array([[scans[t][key] for key in ("x", "y", "theta")] for t in sorted(scans, key=float)])
    raw[:, 2] = np.unwrap(raw[:, 2])
    return replace(log, odometry=raw, odometry_start=raw)


@pytest.mark.slow
def test_intel_closes_even_with_the_odometry_that_its_robot_recorded(real_data: Path) -> None:
    log = raw_intel(real_data)
    assert log.odometry is not None
    closed = closed_map(log, np.stack([log.odometry, log.odometry], axis=1))
    relations = read_relations(real_data / "logs" / "intel.relations")
    error = relation_error(log.t_s, closed.mapped.poses, relations)
    before = relation_error(log.t_s, log.odometry, relations)
    assert error is not None
    assert before is not None
    assert before.translation_m.mean() > 5.0
    assert error.translation_m.mean() < 0.115  # GMapping's
    assert np.median(error.translation_m) < 0.03
