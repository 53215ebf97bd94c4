from __future__ import annotations

import json
import math

import numpy as np
from pytest import approx

from rendezvous.evaluation.frame_error.estimates import OVERLAP_BINS
from rendezvous.evaluation.frame_error.summary import Summary, comparisons, ranking, summary
from rendezvous.evaluation.statistics import resample_weights
from tests.evaluation.toy_pairs import outcomes_of, tables_of

OVERLAP = (0.05, 0.15, 0.2, 0.3, 0.9, 0.95)
WEIGHTS = resample_weights(np.arange(6), rng=np.random.default_rng(0), resamples=500)
ERROR = np.array(
    [
        [3.0, -4.0, 0.5],
        [0.1, 0.1, -0.01],
        [-0.2, 0.1, 0.02],
        [0.0, 0.0, 0.0],
        [0.1, -0.1, 0.0],
        [0.2, 0.0, 0.04],
    ]
)


def test_figures_are_those_of_the_errors_in_total_and_in_each_bin_of_overlap():
    found = summary(outcomes_of(ERROR, overlap=OVERLAP), WEIGHTS)
    assert [mean.value for mean in found.overall.mean] == approx(np.abs(ERROR).mean(axis=0))
    assert found.overall.median == approx(tuple(np.median(np.abs(ERROR), axis=0)))
    assert found.overall.position_m.value == approx(np.hypot(ERROR[:, 0], ERROR[:, 1]).mean())
    assert found.overall.success.value == approx(5 / 6)
    assert found.duration_median_s == approx(0.0035)
    assert list(found.by_overlap) == list(OVERLAP_BINS)
    bins = list(found.by_overlap.values())
    assert [found.count for found in bins] == [1, 2, 1, 2]
    assert bins[0].position_m.value == approx(5.0)
    assert bins[0].success.value == 0.0
    assert bins[1].mean[0].value == approx(0.15)


def test_a_summary_survives_json():
    covariance = np.repeat(np.diag([0.01, 0.01, 0.001])[None], 6, axis=0)
    covariance[0] = 0.0  # infinitely wrong
    for outcomes in (outcomes_of(ERROR), outcomes_of(ERROR, covariance=covariance)):
        before = summary(outcomes, WEIGHTS)
        text = json.dumps(before.to_json(), allow_nan=False)
        after = Summary.from_json(json.loads(text))
        assert json.dumps(after.to_json()) == text
        assert after.by_overlap["< 0.1"] is None
        assert math.isnan(after.warnings.wrong_flagged.value)
    assert after.calibration.nees_mean == math.inf


def test_the_method_with_smaller_errors_is_better_beyond_doubt():
    rng = np.random.default_rng(1)
    error = rng.normal(0.0, 1.0, (80, 3)) * (1.0, 1.0, 0.1)
    weights = resample_weights(np.arange(80), rng=rng)
    found = tables_of(far=error, near=0.5 * error)
    assert ranking(found) == ["near", "far"]
    (only,) = comparisons(found, weights)
    assert (only.better, only.other) == ("near", "far")
    half = -0.5 * float(np.hypot(error[:, 0], error[:, 1]).mean())
    assert only.position_m.value == approx(half)
    assert only.position_m.high < 0.0
    assert only.heading_rad.high < 0.0
    assert only.success.value > 0.0


def test_the_best_method_is_compared_with_each_other_one_and_is_not_better_than_itself():
    found = tables_of(c=3.0 * ERROR, a=ERROR, b=ERROR)
    same, worse = comparisons(found, WEIGHTS)
    assert [(c.better, c.other) for c in (same, worse)] == [("a", "b"), ("a", "c")]
    assert not any(d.excludes_zero for d in (same.position_m, same.heading_rad, same.success))
    assert comparisons(tables_of(a=ERROR), WEIGHTS) == []
