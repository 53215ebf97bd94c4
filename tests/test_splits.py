from __future__ import annotations

import hashlib

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rendezvous.errors import SplitError
from rendezvous.splits import plans_needed, split_of, split_plans

digests = st.integers(0, 2**32).map(lambda n: hashlib.sha256(str(n).encode()).hexdigest())


def _split(digest: str, validation: float = 0.1, test: float = 0.1) -> str:
    return split_of(digest, validation_fraction=validation, test_fraction=test)


@pytest.mark.parametrize("seed", range(20))
def test_a_plan_keeps_its_split_whatever_plans_come_beside_it(seed):
    plans = {hashlib.sha256(f"{seed} {number}".encode()).hexdigest() for number in range(80)}
    half = sorted(plans)[::2]
    fractions = {"validation_fraction": 0.3, "test_fraction": 0.3}
    assert split_plans(half, **fractions).items() <= split_plans(plans, **fractions).items()


@given(digests, st.floats(0, 0.45), st.floats(0, 0.45), st.floats(0, 0.45))
def test_larger_shares_take_plans_from_training_only(digest, validation, test, more):
    before = _split(digest, validation, test)
    if before != "train":
        assert _split(digest, max(validation, more), test) == before
        assert _split(digest, validation, max(test, more)) == before


def test_shares_come_out_as_asked():
    plans = [hashlib.sha256(str(n).encode()).hexdigest() for n in range(20_000)]
    found = [_split(plan, 0.1, 0.2) for plan in plans]
    # Binomial: three standard deviations are below 0.01.
    assert found.count("validation") / len(plans) == pytest.approx(0.1, abs=0.01)
    assert found.count("test") / len(plans) == pytest.approx(0.2, abs=0.01)


def test_the_split_of_a_plan_is_a_promise_to_published_datasets():
    plans = [hashlib.sha256(str(n).encode()).hexdigest() for n in range(12)]
    found = [_split(plan, 0.2, 0.2) for plan in plans]
    assert [i for i, split in enumerate(found) if split == "validation"] == [3, 4, 6]
    assert [i for i, split in enumerate(found) if split == "test"] == [1, 5, 7, 10, 11]


def test_an_empty_split_says_how_many_plans_are_needed():
    with pytest.raises(SplitError, match=r"would be empty: 1 floor plans, .* about 51 plans leave no split"):
        split_plans(["a"], validation_fraction=0.1, test_fraction=0.1)


def test_a_split_of_no_share_may_be_empty():
    assert split_plans(["a", "b"], validation_fraction=0.0, test_fraction=0.0) == {"a": "train", "b": "train"}


@pytest.mark.parametrize(("validation", "test"), [(0.3, 0.7), (0.1, 0.9), (0.0, 1.0)])
def test_nothing_need_be_left_for_training(validation, test):
    plans = [hashlib.sha256(str(n).encode()).hexdigest() for n in range(200)]
    splits = split_plans(plans, validation_fraction=validation, test_fraction=test)
    assert "train" not in splits.values()
    assert ("validation" in splits.values()) == (validation > 0.0)


def test_plans_needed_is_the_smallest_number_that_suffices():
    # Two shares of a tenth: 2 · 0.9^n <= 0.01, the train split adds nothing at this n.
    assert plans_needed({"train": 0.8, "validation": 0.1, "test": 0.1}) == 51
    assert 2 * 0.9**51 <= 0.01 < 2 * 0.9**50
