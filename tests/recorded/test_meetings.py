"""Where two stretches of one log come within sight of each other."""

import numpy as np
import pytest

from rendezvous.errors import ConfigError
from rendezvous.geometry.se2 import SE2
from rendezvous.recorded.meetings import Stretches, draw_meeting, driven_parts, sees
from tests.recorded.drive import driven, laser_log

_DRIVE = driven(scans=80)
_LOG = laser_log(_DRIVE)
_STRETCHES = Stretches(length_m=(1.5, 4.0), distance_m=(0.4, 3.0))


def _drawn(log, stretches=_STRETCHES, relations=None, count=60):
    parts = driven_parts(log)
    draws = (
        draw_meeting(log, parts, stretches, relations=relations, rng=np.random.default_rng(seed))
        for seed in range(count)
    )
    return [meeting for meeting in draws if meeting is not None]


def test_the_other_robot_is_seen_only_where_beams_go_beyond_it():
    # The first scan looks along x from (1, 1.4): the pillar is at x 2 to 2.6, y 3 to 3.8.
    x, y, yaw = _DRIVE.poses_w[0]
    in_w = np.array([[4.0, 1.5], [2.3, 3.4], [2.6, 4.3], [0.2, 1.4], [12.0, 1.5]])
    p_r = SE2(x, y, yaw).inverse() @ in_w
    assert sees(_LOG, 0, p_r).tolist() == [True, False, False, False, False]


def test_nothing_is_seen_where_there_is_no_measurement_but_in_open_space_all():
    ahead = np.array([[1.0, 0.0]])
    for value, seen in ((np.nan, False), (np.inf, True), (0.9, False), (1.1, True)):
        ranges_m = np.full((80, 180), value)
        assert sees(laser_log(_DRIVE, ranges_m=ranges_m), 3, ahead).tolist() == [seen]


def test_a_meeting_is_of_two_stretches_that_share_no_scan_and_end_in_sight():
    meetings = _drawn(_LOG)
    assert len(meetings) > 20
    for meeting in meetings:
        assert not {*meeting.scans_0.tolist()} & {*meeting.scans_1.tolist()}
        for scans in (meeting.scans_0, meeting.scans_1):
            assert {*np.diff(scans).tolist()} in ({1}, {-1})
            way_m = abs(np.diff(_LOG.travelled_m()[scans[[0, -1]]])[0])
            assert 1.5 <= way_m <= 4.0 + 0.5
        true = SE2.from_array(_DRIVE.poses_w[meeting.scans_0[-1]]).inverse() @ SE2.from_array(
            _DRIVE.poses_w[meeting.scans_1[-1]]
        )
        assert meeting.T_r0_r1 == pytest.approx(true.wrapped().as_array(), abs=1e-9)
        assert 0.4 <= np.hypot(*meeting.T_r0_r1[:2]) <= 3.0
        assert sees(_LOG, int(meeting.scans_0[-1]), meeting.T_r0_r1[None, :2]).all()
    directions = {(m.scans_0[0] < m.scans_0[-1], m.scans_1[0] < m.scans_1[-1]) for m in meetings}
    assert len(directions) > 2


def test_robots_meet_only_where_relations_say_how():
    pairs, motions = np.array([[5, 70], [10, 60]]), np.array([[0.5, 0.1, 3.0], [0.6, -0.1, 2.0]])
    meetings = _drawn(_LOG, relations=(pairs, motions), count=400)
    assert meetings
    for meeting in meetings:
        which = pairs[:, 0].tolist().index(meeting.scans_0[-1])
        assert meeting.scans_1[-1] == pairs[which, 1]
        assert meeting.T_r0_r1.tolist() == motions[which].tolist()


def test_no_stretch_crosses_a_jump_of_the_robot():
    poses = _DRIVE.poses_w.copy()
    poses[40:, 0] += 50.0
    log = laser_log(_DRIVE, reference=poses)
    assert driven_parts(log).tolist() == [0] * 40 + [1] * 40
    meetings = _drawn(log)
    assert meetings
    for meeting in meetings:
        assert (meeting.scans_0 < 40).all() or (meeting.scans_0 >= 40).all()
        assert (meeting.scans_1 < 40).all() or (meeting.scans_1 >= 40).all()


def test_a_robot_that_stood_still_meets_no_one():
    still = laser_log(_DRIVE, reference=np.zeros((80, 3)))
    assert _drawn(still) == []


def test_lengths_must_rise():
    with pytest.raises(ConfigError, match=r"Stretches: length_m is \[4.0, 3.0\]; must be two rising"):
        Stretches(length_m=(4.0, 3.0), distance_m=(0.4, 3.0))
