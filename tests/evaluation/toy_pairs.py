"""Pairs of maps drawn in a moment, toy methods, and outcomes made of numbers."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import pandas as pd

from rendezvous.alignment.estimate import Estimate
from rendezvous.evaluation.frame_error.estimates import Outcome, outcome, outcome_table
from rendezvous.evaluation.pictures.map_panels import PairMaps
from rendezvous.geometry.se2 import SE2, Array
from rendezvous.training.frame_error.pairs import (
    MapPair,
    PerturbationRange,
    PerturbedPair,
    evaluation_perturbation,
    perturbed_pair,
)
from tests.synthetic import synthetic_row


def toy_pair(plan: int) -> MapPair:
    """A synthetic sighting as an estimator's test needs it."""
    row = synthetic_row(np.random.default_rng(plan), plan=plan)
    grid_0, grid_1 = PairMaps.of(row).grids
    poses = {name: row[name] for name in ("T_m0_r0", "T_m1_r1")} | {"T_m0_m1": row["T_m0_m1_local"]}
    return MapPair(pair_id=row["pair_id"], grid_0=grid_0, grid_1=grid_1, overlap=row["overlap"], **poses)


def toy_sample(pair: MapPair, *, seed: int = 0) -> PerturbedPair:
    """The pair with maps wrongly laid over each other."""
    return perturbed_pair(pair, evaluation_perturbation(pair.pair_id, PerturbationRange(), seed=seed))


def toy_outcomes(pairs: Sequence[MapPair], *, off: SE2, failing: bool = False) -> list[Outcome]:
    """Of a method that is always off by the same motion, or always fails."""
    covariance = np.diag([0.01, 0.01, 0.001])
    rows = []
    for pair in pairs:
        sample = toy_sample(pair)
        right = Estimate(theta=sample.theta_v @ off.inverse(), covariance=covariance)
        estimate = Estimate(theta=None, reason="a toy") if failing else right
        rows.append(outcome(estimate, pair, sample, duration_s=0.01))
    return rows


def outcomes_of(
    error: Array,
    *,
    covariance: Array | None = None,
    tails: float = math.inf,
    ambiguous: Sequence[bool] | None = None,
    failed: Sequence[bool] | None = None,
    overlap: float | Sequence[float] = 0.3,
) -> pd.DataFrame:
    """An outcome table with these errors (N, 3) of one method: a failure's is that of answering zero."""
    rows = [
        Outcome(
            pair_id=f"pair-{i}",
            theta=SE2.from_array(off),
            theta_hat=None if failed and failed[i] else SE2.identity(),
            covariance=None if covariance is None else covariance[i],
            degrees_of_freedom=tails,
            ambiguous=bool(ambiguous and ambiguous[i]),
            reason="",
            log_density=None,
            meeting_error_m=math.hypot(*off[:2]),
            duration_s=0.001 * (i + 1),
        )
        for i, off in enumerate(error)
    ]
    return outcome_table({"toy": rows}, np.broadcast_to(overlap, len(error)))


def tables_of(*, overlap: float | Sequence[float] = 0.3, **errors: Array) -> pd.DataFrame:
    """An outcome table of methods with these errors (N, 3)."""
    tables = [outcomes_of(error, overlap=overlap).assign(method=name) for name, error in errors.items()]
    return pd.concat(tables)
