"""Outcomes of pairs under estimators of the frame error."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import partial
from typing import Any, Protocol, runtime_checkable

from rendezvous.alignment.estimate import FrameErrorEstimator
from rendezvous.alignment.window import MapWindow
from rendezvous.commands.evaluate.measuring import Measurement
from rendezvous.evaluation.frame_error.estimates import Outcome, outcome
from rendezvous.stages.weights.estimators import SelectedMethod
from rendezvous.training.frame_error.pairs import (
    MapPair,
    PairTable,
    Perturbation,
    PerturbationRange,
    evaluation_perturbation,
    perturbed_pair,
)

Sample = tuple[MapPair, Perturbation]


@runtime_checkable
class PosteriorEstimator(Protocol):
    """An estimator that has a density as well."""

    def posterior(self, window: MapWindow) -> Any:
        """An object with `log_density(theta)`."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Trial:
    """The pairs on which all methods are measured, each with one perturbation."""

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
        """A column of the pairs' table, in the order of the pairs."""
        return [self.pairs.table[name][index].as_py() for index in self.indices]

    def drawn(self) -> dict[str, dict[str, Any]]:
        """The perturbations by pair id."""
        return dict(zip(self.column("pair_id"), (asdict(p) for p in self.perturbations), strict=True))


def measurement(
    selected: SelectedMethod, estimator: FrameErrorEstimator | None, trial: Trial
) -> Measurement[Sample, Outcome]:
    """How each pair is measured, and what that depends on; of a user's method the code is not known.

    A method without a loaded network, whose `estimator` is None, runs in worker processes.
    """
    key = {
        "method": selected.name,
        "search": asdict(selected.search),
        "weights": selected.weights_digest(),
        "data": trial.pairs.digest(),
        "drawn": trial.drawn(),
    }
    return Measurement(
        command="evaluate",
        cache="frame_error",
        name=selected.name,
        items_name="pairs",
        measure=partial(_measure, selected, estimator),
        outcome=Outcome,
        in_this_process=estimator is not None,
        key=key if selected.method.shipped else {},
    )


def _measure(
    selected: SelectedMethod, estimator: FrameErrorEstimator | None, pairs: Sequence[Sample]
) -> tuple[Outcome, ...]:
    estimator = estimator or selected.method.estimator(selected.search)
    # Once without timing: the first call loads compiled code.
    estimator(perturbed_pair(*pairs[0]).window)
    return tuple(_outcome(estimator, pair, perturbation) for pair, perturbation in pairs)


def _outcome(estimator: FrameErrorEstimator, pair: MapPair, perturbation: Perturbation) -> Outcome:
    sample = perturbed_pair(pair, perturbation)
    started_s = time.perf_counter()
    estimate = estimator(sample.window)
    duration_s = time.perf_counter() - started_s
    log_density = None
    if isinstance(estimator, PosteriorEstimator) and estimate.theta is not None:
        density = float(estimator.posterior(sample.window).log_density(sample.theta_v))
        # A density of zero becomes the smallest that a double holds, so that means stay finite.
        log_density = max(density, -745.0)
    return outcome(estimate, pair, sample, log_density=log_density, duration_s=duration_s)
