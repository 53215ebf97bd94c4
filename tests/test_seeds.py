"""Random streams."""

from __future__ import annotations

import pytest

from rendezvous.seeds import stream


def first(*key: int | str) -> float:
    return stream(*key).random()


def test_equal_keys_give_equal_streams():
    assert first(0, "explore", "plan", 3) == first(0, "explore", "plan", 3)


def test_a_stream_does_not_change_between_versions():
    assert first(0, "explore", "plan", 3) == 0.140506206474449


@pytest.mark.parametrize(
    "other",
    [
        (1, "explore", "plan", 3),
        (0, "meshes", "plan", 3),
        (0, "explore", "plan", 4),
        (0, "explore", "plan", "3"),
        (0, "explore", "plan"),
        (0, "explorep", "lan", 3),
    ],
)
def test_any_other_key_gives_another_stream(other: tuple):
    assert first(*other) != first(0, "explore", "plan", 3)
