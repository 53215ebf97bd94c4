"""That benchmarks still know what they measure."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

pytest.importorskip("torch")

from benchmarks.fuse import _Costs, _fuse, _medians_ms, _synthetic
from benchmarks.training import synthetic_pairs
from pipeline.fusion.refinement import Refinement, correlative_refiner
from pipeline.training.data import TrainingBatches
from pipeline.training.parameters import Sampling


def test_samples_are_drawn_from_the_pairs_that_training_is_timed_on():
    batch = TrainingBatches(synthetic_pairs(), Sampling(), seed=0, batch_size=2)[0]
    assert batch["cells"].any()
    assert batch["theta"].abs().sum() > 0.0


def test_every_part_of_a_fusion_is_timed_and_the_pair_is_one_that_can_be_fused(tmp_path: Path):
    costs = _Costs()
    refiners = {Refinement.NONE: None, Refinement.CORRELATIVE: correlative_refiner}
    _fuse(_synthetic(tmp_path), None, refiners, costs)
    parts = {"read maps", "refine correlative", "merge", "check", "draw", "draw and write"}
    assert parts <= set(_medians_ms(costs.cpu)) == set(_medians_ms(costs.wall))
    told = json.loads((tmp_path / "out" / "result.json").read_text())
    assert told["overlap"] > 0.5
