"""Calibrate a trained matcher on validation pairs; the calibration is stored with the weights."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
from rich.console import Console

from rendezvous.alignment.window import DEFAULT_SEARCH
from rendezvous.engine.progress import meter
from rendezvous.errors import ConfigError
from rendezvous.models.matcher_calibration import CalibrationPair, MatcherCalibration, fitted
from rendezvous.models.matcher_estimator import MatcherEstimator
from rendezvous.seeds import stream
from rendezvous.stages.weights.trained_estimators import load
from rendezvous.store.disk import Disk
from rendezvous.store.read import StageReader
from rendezvous.training.checkpoint import read_checkpoint, with_record
from rendezvous.training.frame_error.augmentation import Augmentation, augmented
from rendezvous.training.frame_error.pairs import (
    MapPair,
    PairTable,
    PerturbationRange,
    evaluation_perturbation,
    perturbed_pair,
    read_pairs,
)
from rendezvous.training.frame_error.short_visits import ShortVisits, of_short_visits

PAIRS = 400  # enough, spread evenly over the validation split, to measure a coverage to within three points
_SPLIT = "validation"
LEAST_PAIRS = 20
VERSIONS = 3  # of each pair that are read
MOVED = Augmentation(
    untouched=0.0, furniture=1.0, cut=0.0, bend=0.0, resolution=0.0, rescan=0.0, spurious=0.0, thick=0.0,
    ragged=0.0, patches=0.0, specks=0.0,
)  # fmt: skip
"""Between two visits furniture moves."""
LIKE_REAL = replace(MOVED, bend=1.0, bend_m=0.1, thick=0.2, ragged=0.5)
"""And maps are bent as SLAM bends those of real buildings, by some cells."""


def calibrate(
    weights: Path, dataset: str, *, seed: int, threads: int, count: int = PAIRS, console: Console
) -> MatcherCalibration:
    """Write a calibration into the file of a matcher's weights; the weights themselves stay the same.

    Each pair is read as it is and as after short visits, which says how much to trust what speaks for a peak;
    and as after short visits with maps like those of real buildings, which says how far errors spread.

    Raises:
        StoreError: weights or dataset are missing or damaged.
        ConfigError: the weights are of another model, or there are too few validation pairs.
    """
    disk = Disk(str(weights.parent))
    found, where = read_checkpoint(disk.read(weights.name), where=str(weights)), str(weights)
    # Without an earlier calibration.
    bare = with_record(found, calibration=MatcherCalibration().as_dict())
    estimator = load(bare, "matcher", DEFAULT_SEARCH, where=where, threads=threads).estimator
    assert isinstance(estimator, MatcherEstimator)
    pairs = read_pairs(StageReader(dataset, "pack"), _SPLIT)
    readings = _readings(estimator, pairs, seed, count, console)
    count = len(readings) // VERSIONS
    if count < LEAST_PAIRS:
        raise ConfigError(
            f"{dataset}: {count} validation pairs show both maps; a calibration needs {LEAST_PAIRS}"
        )
    calibration = fitted(readings)
    calibrated_on = {"pairs": count, "data": pairs.digest()}
    disk.write(
        weights.name, with_record(found, calibration=calibration.as_dict(), calibrated_on=calibrated_on)
    )
    console.print(_summary(calibration, count), highlight=False)
    return calibration


def _summary(calibration: MatcherCalibration, pairs: int) -> str:
    return (
        f"calibrate: on {pairs} validation pairs: sharpness {calibration.sharpness:.2f}; covariance times "
        f"{calibration.scale:.2f}, at least {1e3 * calibration.floor_m:.1f} mm, "
        f"{np.degrees(calibration.floor_rad):.2f} deg; {calibration.degrees_of_freedom:.1f} degrees of "
        f"freedom; ambiguous below {calibration.least_mass:.3f}"
    )


def _readings(
    estimator: MatcherEstimator, pairs: PairTable, seed: int, count: int, console: Console
) -> list[CalibrationPair]:
    count = min(count, len(pairs))
    readings = []
    with meter("calibrate", total=count, console=console, parts="pairs", rows="pairs") as progress:
        for place in np.linspace(0, len(pairs) - 1, count).round():
            pair = pairs[int(place)]
            for one, like_real in _versions(pair, seed):
                perturbation = evaluation_perturbation(pair.pair_id, PerturbationRange(), seed=seed)
                sample = perturbed_pair(one, perturbation)
                if sample.window.cells.any(axis=(1, 2)).all():
                    posterior = estimator.posterior(sample.window)
                    readings.append(
                        CalibrationPair(posterior=posterior, theta=sample.theta_v, like_real=like_real)
                    )
            progress.advance(1, made=True)
    return readings


def _versions(pair: MapPair, seed: int) -> Iterator[tuple[MapPair, bool]]:
    """The pair as it is, after short visits, and after such with maps like real ones, which is told."""
    yield pair, False
    for name, changes, like_real in (("visits", MOVED, False), ("real", LIKE_REAL, True)):
        rng = stream(seed, "calibration", pair.pair_id, name)
        yield of_short_visits(augmented(pair, changes, rng), ShortVisits(), rng), like_real
