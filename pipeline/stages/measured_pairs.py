"""Run estimators over pairs: in worker processes or in this one, and never twice over the same."""

from __future__ import annotations

import json
import math
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from importlib import metadata
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

from rich.console import Console

import pipeline
from pipeline.alignment.estimate import FrameErrorEstimator
from pipeline.alignment.window import MapWindow
from pipeline.evaluation.estimates import Outcome, Outcomes, outcome
from pipeline.pool import Call, Engine, run_calls
from pipeline.progress import meter
from pipeline.stages.estimators import Method, baseline
from pipeline.store.disk import Disk
from pipeline.store.records import digest_of, json_bytes
from pipeline.training.pairs import MapPair, PairTable
from pipeline.training.perturbation import (
    Perturbation,
    PerturbationRange,
    evaluation_perturbation,
    perturbed_pair,
)

CACHE = "frame_error"
_PAIRS_PER_CALL = 16
_CODE = Path(pipeline.__path__[0])
_ROOMS = ("geometry", "alignment", "training")
_FILES = (
    "evaluation/estimates.py",
    "stages/estimators.py",
    "stages/measured_pairs.py",
    "stages/trained_estimators.py",
)
_PACKAGES = ("numpy", "scipy", "opencv-python-headless", "numba")
"""What outcomes depend on, beside the method's own room."""
Numbered = tuple[int, tuple[Outcome, ...]]
"""Outcomes of neighbouring pairs, and the number of the first."""


@runtime_checkable
class PosteriorEstimator(Protocol):
    """An estimator that gives a density as well."""

    def posterior(self, window: MapWindow) -> Any:
        """Something with `log_density(theta)`."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Trial:
    """The pairs on which all methods are measured, each with its one perturbation."""

    pairs: PairTable
    indices: tuple[int, ...]
    perturbations: tuple[Perturbation, ...]

    @staticmethod
    def of(pairs: PairTable, indices: Sequence[int], range_: PerturbationRange, *, seed: int) -> Trial:
        """Draws the perturbations."""
        pair_ids = [pairs.table["pair_id"][index].as_py() for index in indices]
        return Trial(
            pairs=pairs,
            indices=tuple(indices),
            perturbations=tuple(evaluation_perturbation(name, range_, seed=seed) for name in pair_ids),
        )

    def __getitem__(self, number: int) -> tuple[MapPair, Perturbation]:
        return self.pairs[self.indices[number]], self.perturbations[number]

    def column(self, name: str) -> list[Any]:
        """A column of the pairs, in order."""
        return [self.pairs.table[name][index].as_py() for index in self.indices]

    def data_digest(self) -> str:
        """Of the whole split."""
        return self.pairs.digest()

    def drawn(self) -> dict[str, dict[str, Any]]:
        """The perturbations by the pair's id."""
        return dict(zip(self.column("pair_id"), (asdict(p) for p in self.perturbations), strict=True))


def measured(
    method: Method,
    estimator: FrameErrorEstimator | None,
    trial: Trial,
    *,
    folder: Path,
    workers: int,
    console: Console,
) -> Outcomes:
    """What becomes of each pair under a method; from the cache, if nothing that it depends on has changed.

    Args:
        method: the method.
        estimator: the loaded network; None for a method without one, which runs in worker processes.
        trial: the pairs.
        folder: of the report.
        workers: processes; a single one is this one.
        console: where to tell.
    """
    key = cache_key(method, trial, workers=workers)
    disk, name = Disk(str(folder / CACHE)), f"{method.name}-{key[:16]}.json"
    if (kept := _kept(disk, name)) is not None:
        console.print(f"evaluate {method.name}: {len(kept)} pairs, as measured before", highlight=False)
        return kept
    outcomes = _run(method, estimator, trial, workers, console)
    disk.write(name, json_bytes({"rows": [row.to_json() for row in outcomes.rows]}))
    return outcomes


def cache_key(method: Method, trial: Trial, *, workers: int) -> str:
    """Digest of all that outcomes depend on, the time that they take included."""
    packages = (*_PACKAGES, "torch") if method.learned else _PACKAGES
    return digest_of(
        {
            "method": method.name,
            "search": asdict(method.search),
            "weights": method.weights_digest(),
            "code": _code_digest("models" if method.learned else "baselines"),
            "packages": {package: metadata.version(package) for package in packages},
            "workers": workers,
            "data": trial.data_digest(),
            "drawn": trial.drawn(),
        }
    )


def _run(
    method: Method, estimator: FrameErrorEstimator | None, trial: Trial, workers: int, console: Console
) -> Outcomes:
    engine = Engine.LOCAL if estimator is None and workers > 1 else Engine.INLINE
    total = math.ceil(len(trial.indices) / _PAIRS_PER_CALL)
    found: dict[int, tuple[Outcome, ...]] = {}
    with meter(
        f"evaluate {method.name}", total=total, console=console, parts="batches", rows="pairs"
    ) as progress:
        calls = _calls(method, estimator, trial)
        for first, rows in run_calls(calls, engine=engine, workers=min(workers, total)):
            found[first] = rows
            progress.advance(len(rows), made=True)
    return Outcomes(tuple(row for first in sorted(found) for row in found[first]))


def _calls(method: Method, estimator: FrameErrorEstimator | None, trial: Trial) -> Iterator[Call[Numbered]]:
    for first in range(0, len(trial.indices), _PAIRS_PER_CALL):
        numbers = range(first, min(first + _PAIRS_PER_CALL, len(trial.indices)))
        yield partial(_measure, first, method, estimator, tuple(trial[number] for number in numbers))


def _measure(
    first: int,
    method: Method,
    estimator: FrameErrorEstimator | None,
    pairs: Sequence[tuple[MapPair, Perturbation]],
) -> Numbered:
    estimator = estimator or baseline(method)
    # Once untimed: compiled code is loaded at the first call.
    estimator(perturbed_pair(*pairs[0]).window)
    return first, tuple(_outcome(estimator, pair, perturbation) for pair, perturbation in pairs)


def _outcome(estimator: FrameErrorEstimator, pair: MapPair, perturbation: Perturbation) -> Outcome:
    sample = perturbed_pair(pair, perturbation)
    started_s = time.perf_counter()
    estimate = estimator(sample.window)
    duration_s = time.perf_counter() - started_s
    log_density = None
    if isinstance(estimator, PosteriorEstimator) and estimate.theta is not None:
        log_density = _finite(estimator.posterior(sample.window).log_density(sample.theta_w))
    return outcome(estimate, pair, sample, log_density=log_density, duration_s=duration_s)


def _finite(log_density: float) -> float:
    """A density of zero as the smallest that a double holds, so that a mean stays a number."""
    return max(float(log_density), -745.0)


def _kept(disk: Disk, name: str) -> Outcomes | None:
    if disk.size(name) is None:
        return None
    try:
        return Outcomes(tuple(Outcome.from_json(row) for row in json.loads(disk.read(name))["rows"]))
    except (ValueError, KeyError, TypeError):
        return None


def _code_digest(room: str) -> str:
    """Of the source of a method's room and of all that makes an outcome of what it finds."""
    rooms = (path for each in (*_ROOMS, room) for path in (_CODE / each).glob("*.py"))
    sources = [*(_CODE / name for name in _FILES), *rooms]
    return digest_of(
        {str(path.relative_to(_CODE)): path.read_text(encoding="utf-8") for path in sorted(sources)}
    )


def perturbation_json(drawn: Mapping[str, Mapping[str, Any]]) -> bytes:
    """The perturbations of all pairs, to be kept beside the report."""
    return json_bytes(
        {
            "about": "theta_c: frame error x [m], y [m], yaw [rad] at the meeting point, in the axes of m0; "
            "rotation_rad: heading of the window in m0",
            "pairs": dict(drawn),
        }
    )
