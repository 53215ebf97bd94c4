"""Rows and samples by their numbers, for any model."""

from __future__ import annotations

import pytest
import torch

from rendezvous.training.batches import EpochOrder, NumberedBatches, evenly_spread, moved


@pytest.mark.parametrize(
    ("rows", "count", "picked"),
    [(9, 3, [0, 4, 8]), (10, 4, [0, 3, 6, 9]), (5, 5, [0, 1, 2, 3, 4]), (3, 10, [0, 1, 2]), (7, 1, [0])],
)
def test_rows_are_spread_evenly_from_the_first_to_the_last(rows: int, count: int, picked: list[int]):
    assert evenly_spread(range(100, 100 + rows), count) == [100 + row for row in picked]


class Numbers(NumberedBatches):
    """Samples that are their numbers."""

    def sample(self, number: int) -> int:
        return number

    def batch(self, samples: list[int]) -> dict[str, torch.Tensor]:
        return {"number": torch.tensor(samples)}


def test_processes_take_turns_batch_by_batch():
    shares = [Numbers(seed=0, batch_size=2, rank=rank, processes=3) for rank in range(3)]
    assert [batches[1]["number"].tolist() for batches in shares] == [[6, 7], [8, 9], [10, 11]]


def test_an_epoch_can_be_read_in_any_order_and_depends_on_the_seed():
    forth = [EpochOrder(5, seed=0).row(number) for number in range(15)]
    order = EpochOrder(5, seed=0)
    back = [order.row(number) for number in reversed(range(15))]
    assert forth == back[::-1]
    assert forth != [EpochOrder(5, seed=1).row(number) for number in range(15)]


def test_a_batch_is_moved_whole():
    batch = {"cells": torch.arange(3), "theta": torch.ones(2)}
    there = moved(batch, torch.device("meta"))
    assert there.keys() == batch.keys()
    assert {tensor.device.type for tensor in there.values()} == {"meta"}
