"""Calls on this process: one by one, each library with one thread."""

from __future__ import annotations

import os
from collections.abc import Iterator

import pytest

from rendezvous.engine.pool import Call, Engine, run_calls

THREADS = (
    "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS",
    "OPENCV_FOR_THREADS_NUM", "LP_NUM_THREADS", "RAYON_NUM_THREADS", "ARROW_NUM_THREADS",
)  # fmt: skip


def test_workers_of_any_engine_inherit_one_thread_for_each_library(monkeypatch: pytest.MonkeyPatch):
    for name in THREADS:
        monkeypatch.setenv(name, "7")
    calls = [lambda name=name: os.environ[name] for name in THREADS]
    assert list(run_calls(calls, engine=Engine.INLINE, workers=1)) == ["1"] * len(THREADS)


def test_calls_are_made_in_order_each_when_its_result_is_asked_for(monkeypatch: pytest.MonkeyPatch):
    for name in THREADS:
        monkeypatch.setenv(name, "1")
    log: list[str] = []

    def calls() -> Iterator[Call[int]]:
        for number in range(3):
            log.append(f"pull {number}")
            yield lambda number=number: log.append(f"call {number}") or number

    results = run_calls(calls(), engine=Engine.INLINE, workers=1)
    assert log == []
    assert next(results) == 0
    assert log == ["pull 0", "call 0"]
    assert list(results) == [1, 2]
