"""Whether two submaps show one place."""

from __future__ import annotations

import math

import numpy as np
import pytest

from rendezvous.baselines.correlative import CorrelativeSearch
from rendezvous.geometry.se2 import Array
from rendezvous.loop_closure.matching import LoopMatcher, LoopWindow
from rendezvous.loop_closure.submaps import SubmapPath, SubmapTracker
from rendezvous.recorded.laser_log import LaserLog
from rendezvous.recorded.mapped import LidarModel, LogScans
from rendezvous.slam.slam import SlamParameters, compose, relative
from tests.loop_closure.building import driven_around

WINDOW = LoopWindow(searching=lambda search: CorrelativeSearch(search=search), cell_m=0.1)
WIDE = np.diag([0.8, 0.8, 0.2]) ** 2


@pytest.fixture(scope="module")
def around() -> tuple[LaserLog, SubmapPath, LoopMatcher]:
    log = driven_around()
    assert log.reference is not None
    odometry = np.stack([log.reference, log.reference], axis=1)
    order = np.arange(len(log), dtype=np.int64)
    scans = LogScans(log, order, odometry, lidar=LidarModel(), parameters=SlamParameters())
    tracker = SubmapTracker(scans.parameters, length_m=8.0)
    for i in range(len(scans)):
        tracker.add(scans.scan(i), scans.odometry(i))
    path = tracker.path()
    return log, path, LoopMatcher(scans, path.submaps, WINDOW)


def true_frame(log: LaserLog, path: SubmapPath, number: int) -> Array:
    assert log.reference is not None
    return np.asarray(log.reference[path.submaps[number].scans[0]])


def test_submaps_overlap_by_half_and_every_scan_is_in_one(
    around: tuple[LaserLog, SubmapPath, LoopMatcher],
) -> None:
    log, path, _ = around
    assert set(path.home.tolist()) <= set(range(len(path.submaps)))
    for number, submap in enumerate(path.submaps[:-2]):
        assert (submap.poses[0] == 0.0).all()
        assert (np.diff(submap.scans) == 1).all()
        assert np.hypot(*np.diff(submap.poses[:, :2], axis=0).T).sum() == pytest.approx(16.0, abs=0.9)
        shared = set(submap.scans) & set(path.submaps[number + 1].scans)
        assert 0.4 < len(shared) / len(submap.scans) < 0.6
    assert len(path.poses(path.frames())) == len(log)


def test_a_submap_is_found_where_its_place_was_seen_before(
    around: tuple[LaserLog, SubmapPath, LoopMatcher],
) -> None:
    log, path, matcher = around
    last = len(path.submaps) - 2
    true = relative(true_frame(log, path, 0), true_frame(log, path, last))
    true[2] = math.remainder(true[2], 2.0 * math.pi)
    assert math.hypot(*true[:2]) < 8.0
    loop = matcher(0, last, compose(true, np.array([0.9, -0.7, 0.25])), WIDE)
    assert loop is not None
    assert loop.T_a_b[:2] == pytest.approx(true[:2], abs=0.05)
    assert math.remainder(loop.T_a_b[2] - true[2], 2.0 * math.pi) == pytest.approx(0.0, abs=0.01)
    sigmas = np.sqrt(np.diag(np.linalg.inv(loop.information)))
    assert (sigmas > [0.03, 0.03, math.radians(0.3)]).all()
    assert (sigmas < [0.2, 0.2, math.radians(2.0)]).all()


@pytest.mark.parametrize("other", [2, 3, 4])
def test_another_place_is_no_loop(around: tuple[LaserLog, SubmapPath, LoopMatcher], other: int) -> None:
    _, path, matcher = around
    last = len(path.submaps) - 2
    assert matcher(other, last, np.array([0.5, 0.3, 0.1]), WIDE) is None
