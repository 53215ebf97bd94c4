"""Split floor plans into training, validation and test.

A plan's split follows from its geometry alone: neither other plans, nor their order, nor the seed can change
it. A larger validation or test share only takes plans from training.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Iterable, Mapping

from rendezvous.errors import SplitError

SPLITS = ("train", "validation", "test")


def split_of(plan_digest: str, *, validation_fraction: float, test_fraction: float) -> str:
    """The split of a floor plan."""
    draw = int.from_bytes(hashlib.sha256(f"split {plan_digest}".encode()).digest()[:8], "big") / 2.0**64
    if draw < test_fraction:
        return "test"
    # From the other end, so that a change of one share does not move the other's plans.
    return "validation" if draw >= 1.0 - validation_fraction else "train"


def split_plans(
    plan_digests: Iterable[str], *, validation_fraction: float, test_fraction: float
) -> dict[str, str]:
    """The split of every plan, by its digest.

    Raises:
        SplitError: a split with a positive share would be empty; says how many plans are needed.
    """
    splits = {
        digest: split_of(digest, validation_fraction=validation_fraction, test_fraction=test_fraction)
        for digest in plan_digests
    }
    fractions = {
        # Rounded: 0.3 and 0.7 leave nothing, not 5e-17.
        "train": round(1.0 - validation_fraction - test_fraction, 9),
        "validation": validation_fraction,
        "test": test_fraction,
    }
    empty = [name for name in SPLITS if fractions[name] > 0.0 and name not in splits.values()]
    if empty:
        raise SplitError(
            f"{' and '.join(empty)} would be empty: {len(splits)} floor plans, of which "
            f"{' and '.join(f'{fractions[name]:.0%}' for name in empty)} are wanted there; about "
            f"{plans_needed(fractions)} plans leave no split empty with 99 % probability "
            "(more floor plans, or larger pack.validation_fraction and pack.test_fraction; one of them 1 and "
            "the other 0 publish all as one split)"
        )
    return splits


def plans_needed(fractions: Mapping[str, float], *, probability: float = 0.99) -> int:
    """How many plans leave no split empty with at least this probability.

    By the union bound, which is tight here: two empty splits at once are far less likely than one.
    """
    shares = [fraction for fraction in fractions.values() if fraction > 0.0]
    count = len(shares)
    while math.fsum((1.0 - share) ** count for share in shares) > 1.0 - probability:
        count += 1
    return count
