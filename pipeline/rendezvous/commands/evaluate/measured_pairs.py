"""What becomes of pairs under estimators of the frame error."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

from rich.console import Console

from rendezvous.alignment.estimate import FrameErrorEstimator
from rendezvous.alignment.window import MapWindow
from rendezvous.commands.evaluate import measuring
from rendezvous.commands.evaluate.measuring import Measurement, code_digest
from rendezvous.evaluation.frame_error.estimates import Outcome, Outcomes, outcome
from rendezvous.stages.weights.estimators import Method, baseline
from rendezvous.stages.weights.provenance import versions
from rendezvous.store.disk import Disk
from rendezvous.store.records import json_bytes
from rendezvous.training.frame_error.pairs import MapPair, PairTable
from rendezvous.training.frame_error.perturbation import (
    Perturbation,
    PerturbationRange,
    evaluation_perturbation,
    perturbed_pair,
)

CACHE = "frame_error"
_ROOMS = ("geometry", "alignment", "training")
_FILES = (
    "evaluation/frame_error/estimates.py",
    "stages/weights/estimators.py",
    "commands/evaluate/measured_pairs.py",
    "stages/weights/trained_estimators.py",
)
_PACKAGES = ("numpy", "scipy", "opencv-python-headless", "numba")
"""What outcomes depend on, beside the method's own room."""
Sample = tuple[MapPair, Perturbation]


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

    def __len__(self) -> int:
        return len(self.indices)

    def __getitem__(self, number: int) -> Sample:
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
    rows = measuring.measured(
        measurement(method, estimator, trial),
        trial,
        cache=Disk(str(folder / CACHE)),
        workers=workers,
        console=console,
    )
    return Outcomes(rows)


def measurement(
    method: Method, estimator: FrameErrorEstimator | None, trial: Trial
) -> Measurement[Sample, Outcome]:
    """What is done with each pair, and all that it depends on."""
    packages = (*_PACKAGES, "torch") if method.learned else _PACKAGES
    return Measurement(
        command="evaluate",
        name=method.name,
        items_name="pairs",
        measure=partial(_measure, method, estimator),
        from_json=Outcome.from_json,
        in_this_process=estimator is not None,
        key={
            "method": method.name,
            "search": asdict(method.search),
            "weights": method.weights_digest(),
            "code": code_digest((*_ROOMS, "models" if method.learned else "baselines"), _FILES),
            "packages": versions(packages),
            "data": trial.data_digest(),
            "drawn": trial.drawn(),
        },
    )


def _measure(
    method: Method, estimator: FrameErrorEstimator | None, pairs: Sequence[Sample]
) -> tuple[Outcome, ...]:
    estimator = estimator or baseline(method)
    # Once untimed: compiled code is loaded at the first call.
    estimator(perturbed_pair(*pairs[0]).window)
    return tuple(_outcome(estimator, pair, perturbation) for pair, perturbation in pairs)


def _outcome(estimator: FrameErrorEstimator, pair: MapPair, perturbation: Perturbation) -> Outcome:
    sample = perturbed_pair(pair, perturbation)
    started_s = time.perf_counter()
    estimate = estimator(sample.window)
    duration_s = time.perf_counter() - started_s
    log_density = None
    if isinstance(estimator, PosteriorEstimator) and estimate.theta is not None:
        log_density = _finite(estimator.posterior(sample.window).log_density(sample.theta_v))
    return outcome(estimate, pair, sample, log_density=log_density, duration_s=duration_s)


def _finite(log_density: float) -> float:
    """A density of zero as the smallest that a double holds, so that a mean stays a number."""
    return max(float(log_density), -745.0)


def perturbation_json(drawn: Mapping[str, Mapping[str, Any]]) -> bytes:
    """The perturbations of all pairs, to be kept beside the report."""
    return json_bytes(
        {
            "about": "theta_c: frame error x [m], y [m], yaw [rad] at the meeting point, in the axes of m0; "
            "rotation_rad: heading of the window in m0",
            "pairs": dict(drawn),
        }
    )
