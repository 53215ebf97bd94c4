from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import dataclass

from rich.console import Console

from rendezvous.commands.evaluate.measuring import EvaluationSettings, Measurement, cache_key, measured
from rendezvous.evaluation.json_record import JsonRecord


@dataclass(frozen=True)
class Square(JsonRecord):
    value: int


def _squares(numbers: Sequence[int]) -> list[Square]:
    return [Square(number**2) for number in numbers]


def _measured(folder, count: int, *, workers: int = 1, key: str = "a") -> tuple[list[int], str]:
    """The outcomes, and what was told; without a key, what they depend on is not known."""
    told = io.StringIO()
    measurement = Measurement(
        command="square",
        cache="cache",
        name="toy",
        items_name="numbers",
        measure=_squares,
        outcome=Square,
        key={"count": count, "key": key} if key else {},
    )
    settings = EvaluationSettings(folder=folder, workers=workers, console=Console(file=told))
    return [row.value for row in measured(measurement, range(count), settings)], told.getvalue()


def test_outcomes_stand_in_the_order_of_their_items_whoever_made_them(tmp_path):
    wanted = [number**2 for number in range(50)]
    assert _measured(tmp_path, 50)[0] == wanted
    assert _measured(tmp_path, 50, workers=2)[0] == wanted


def test_the_same_is_kept_and_anything_else_made_anew(tmp_path):
    first, told = _measured(tmp_path, 20)
    assert "before" not in told
    again, told = _measured(tmp_path, 20)
    assert "square toy: 20 numbers, as measured before" in told
    assert again == first
    assert "before" not in _measured(tmp_path, 20, key="b")[1]


def test_what_depends_on_more_than_is_known_is_never_kept(tmp_path):
    for _ in range(2):
        rows, told = _measured(tmp_path, 3, key="")
        assert rows == [0, 1, 4]
        assert "before" not in told
    assert not (tmp_path / "cache").exists()


def test_a_damaged_cache_is_made_anew(tmp_path):
    _measured(tmp_path, 20)
    (kept,) = (tmp_path / "cache").iterdir()
    kept.write_text('{"rows": [{"wrong": 1}]}')
    found, told = _measured(tmp_path, 20)
    assert "before" not in told
    assert found == [number**2 for number in range(20)]


def test_times_of_more_workers_are_other_outcomes():
    measurement = Measurement(
        command="square", cache="cache", name="toy", items_name="numbers", measure=_squares, outcome=Square,
        key={"count": 3},
    )  # fmt: skip
    keys = [cache_key(measurement, workers=workers) for workers in (1, 2, 1)]
    assert keys[0] == keys[2] != keys[1]
