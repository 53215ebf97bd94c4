"""Batches: the same samples however many workers and processes share the work."""

from __future__ import annotations

from dataclasses import replace
from itertools import islice

import numpy as np
import pytest
import torch

from rendezvous.alignment.frame_error import frame_error
from rendezvous.training.batches import EpochOrder, training_loader
from rendezvous.training.frame_error.augmentation import Augmentation
from rendezvous.training.frame_error.data import TrainingBatches, validation_batches
from rendezvous.training.frame_error.pairs import PairTable
from rendezvous.training.parameters import Sampling
from tests.training.tiny import SAMPLING


def batches(pairs: PairTable, **options) -> TrainingBatches:
    return TrainingBatches(pairs, SAMPLING, **({"seed": 0, "batch_size": 3} | options))


def loaded(source: TrainingBatches, *, count: int, first_step: int = 0, workers: int = 0):
    loader = training_loader(source, first_step=first_step, workers=workers, pin_memory=False)
    return list(islice(loader, count))


def same(one, other) -> bool:
    return all(torch.equal(one[key], other[key]) for key in ("cells", "theta"))


def test_any_number_of_workers_gives_the_same_batches_in_order(pairs: PairTable):
    alone, two = (loaded(batches(pairs), count=5, workers=workers) for workers in (0, 2))
    assert all(same(a, b) for a, b in zip(alone, two, strict=True))
    assert not same(alone[0], alone[1])


def test_a_loader_that_starts_later_goes_on_where_another_stopped(pairs: PairTable):
    whole, rest = loaded(batches(pairs), count=4), loaded(batches(pairs), count=2, first_step=2)
    assert same(whole[2], rest[0])
    assert same(whole[3], rest[1])


def test_processes_share_what_one_would_see_in_larger_batches(pairs: PairTable):
    whole = batches(pairs, batch_size=6)[1]
    shares = [batches(pairs, rank=rank, processes=2)[1] for rank in (0, 1)]
    assert torch.equal(torch.cat([share["theta"] for share in shares]), whole["theta"])
    assert torch.equal(torch.cat([share["cells"] for share in shares]), whole["cells"])


def test_a_batch_is_what_models_are_promised(pairs: PairTable):
    batch = TrainingBatches(pairs, Sampling(), seed=0, batch_size=2)[0]
    assert batch["cells"].shape == (2, 2, 384, 384)
    assert batch["cells"].dtype == torch.uint8
    assert batch["theta"].shape == (2, 3)
    assert batch["theta"].dtype == torch.float32
    assert set(batch["cells"].unique().tolist()) == {0, 1, 2}


def test_a_label_is_the_frame_error_of_its_transform(pairs: PairTable):
    source = batches(pairs)
    by_transform = {pair.pair_id: pair for pair in (pairs[index] for index in range(len(pairs)))}
    sample = source.sample(7)
    errors = [
        frame_error(sample.T_estimated, pair.T_m0_m1, sample.T_m0_v).as_array()
        for pair in by_transform.values()
    ]
    gaps = np.abs(np.array(errors) - sample.theta_v.as_array()).max(axis=1)
    assert gaps.min() < 1e-9
    assert source[2]["theta"][1].numpy() == pytest.approx(sample.theta_v.as_array(), abs=1e-6)


def test_every_epoch_sees_every_row_once_in_an_order_of_its_own():
    order = EpochOrder(7, seed=0)
    epochs = [[order.row(7 * epoch + place) for place in range(7)] for epoch in (0, 1, 0)]
    assert sorted(epochs[0]) == sorted(epochs[1]) == list(range(7))
    assert epochs[0] == epochs[2]
    assert epochs[0] != epochs[1]


def test_another_seed_gives_other_samples(pairs: PairTable):
    one = PairTable("train", pairs.table.slice(0, 1))  # whose order is the same for every seed
    for found in (pairs, one):
        assert not same(batches(found)[0], batches(found, seed=1)[0])
        measured = (validation_batches(found, SAMPLING, seed=seed, count=1, batch_size=1) for seed in (0, 1))
        assert not same(*(first for (first,) in measured))


@pytest.mark.parametrize("share", [0.0, 1.0])
def test_sight_is_withheld_from_as_many_samples_as_told(pairs: PairTable, share: float):
    sampling = replace(SAMPLING, sight_withheld=share)
    shown = [TrainingBatches(pairs, sampling, seed=0, batch_size=1)[step]["sight"].any() for step in range(3)]
    assert shown == [not share] * 3


def test_validation_pairs_are_untouched_and_always_the_same(pairs: PairTable):
    wild = Sampling(window_cells=48, window_cell_m=0.4, augmentation=Augmentation(untouched=0.0))
    found = [
        validation_batches(pairs, sampling, seed=0, count=5, batch_size=2) for sampling in (SAMPLING, wild)
    ]
    assert [len(batch["theta"]) for batch in found[0]] == [2, 2, 1]
    assert all(same(a, b) for a, b in zip(*found, strict=True))
