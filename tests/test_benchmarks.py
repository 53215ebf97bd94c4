"""That benchmarks still know what they measure."""

from __future__ import annotations

import pytest

pytest.importorskip("torch")

from benchmarks.training import synthetic_pairs
from pipeline.training.data import TrainingBatches
from pipeline.training.parameters import Sampling


def test_samples_are_drawn_from_the_pairs_that_training_is_timed_on():
    batch = TrainingBatches(synthetic_pairs(), Sampling(), seed=0, batch_size=2)[0]
    assert batch["cells"].any()
    assert batch["theta"].abs().sum() > 0.0
