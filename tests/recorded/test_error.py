"""Errors of paths against references and relations."""

import numpy as np
import pytest

from rendezvous.recorded.error import (
    Relations,
    motions_between,
    reference_error,
    relation_error,
    scans_at,
    segment_error,
)

_PATH = np.column_stack(
    [np.linspace(0.0, 30.0, 61), np.sin(np.linspace(0.0, 6.0, 61)), np.linspace(0.0, 3.0, 61)]
)
_T_S = 10.0 + 0.7 * np.arange(61) + np.random.default_rng(1).uniform(0.0, 0.3, 61)


def _moved(poses, x, y, yaw):
    c, s = np.cos(yaw), np.sin(yaw)
    turned = poses[:, :2] @ np.array([[c, s], [-s, c]]) + [x, y]
    return np.column_stack([turned, poses[:, 2] + yaw])


def _relations(shift_s=0.0):
    first, second = np.arange(0, 50), np.arange(10, 60)
    motions = motions_between(_PATH[first], _PATH[second])
    return Relations(stamps_s=shift_s + np.column_stack([_T_S[first], _T_S[second]]), motions=motions)


def test_a_path_in_another_frame_has_no_error():
    error = reference_error(_moved(_PATH, 3.0, -7.0, 2.0), _PATH)
    assert error.translation_m.max() < 1e-9
    assert error.rotation_rad.max() < 1e-9


def test_a_stretched_path_is_off_by_the_stretch():
    travelled_m = _PATH[:, 0]
    straight = np.column_stack([_PATH[:, 0], np.zeros((61, 2))])
    error = segment_error(1.02 * straight, straight, travelled_m, 20.0)
    assert error.translation_m == pytest.approx(np.full(21, 0.4))
    assert error.to_json()["translation_mean_m"] == pytest.approx(0.4)
    assert segment_error(straight, straight, travelled_m, 31.0) is None


def test_relations_measure_the_motion_between_their_stamps():
    bent = _PATH.copy()
    bent[55:, 1] += 0.3
    bent[55:, 2] += 0.1
    error = relation_error(_T_S, bent, _relations())
    assert error.translation_m[:45] == pytest.approx(np.zeros(45), abs=1e-12)
    assert error.translation_m[45:] == pytest.approx(np.full(5, 0.3))
    assert error.rotation_rad[45:] == pytest.approx(np.full(5, 0.1))


def test_the_shift_of_a_clock_that_started_at_zero_is_found():
    error = relation_error(_T_S + np.random.default_rng(0).uniform(-3e-3, 3e-3, 61), _PATH, _relations(9e8))
    assert len(error.translation_m) == 50
    assert error.translation_m.max() < 1e-9


def test_no_relation_between_two_scans_gives_no_error():
    t_s = 10.0 + np.arange(61)
    apart = Relations(stamps_s=np.array([[10.0, 10.35], [10.35, 11.0]]), motions=np.zeros((2, 3)))
    assert relation_error(t_s, _PATH, apart) is None


def test_scans_are_found_by_their_stamps():
    stamps_s = np.array([10.0, 11.015, 10.35, 70.01, 99.0])
    assert scans_at(10.0 + np.arange(61), stamps_s).tolist() == [0, 1, -1, 60, -1]


def test_a_stamp_beside_that_of_a_scan_is_of_a_scan_that_the_log_lacks():
    known = _relations()
    beside = Relations(
        stamps_s=np.concatenate([known.stamps_s, [[_T_S[20], _T_S[20] + 6e-3]]]),
        motions=np.concatenate([known.motions, [[0.35, 0.0, 0.0]]]),
    )
    every = relation_error(_T_S, _PATH, beside)
    assert len(every.translation_m) == 51
    assert every.translation_m.max() == pytest.approx(0.35)
    apart = relation_error(_T_S, _PATH, beside, told_apart=True)
    assert len(apart.translation_m) == 50
    assert apart.translation_m.max() < 1e-9
