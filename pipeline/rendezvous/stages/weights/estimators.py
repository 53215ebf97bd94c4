"""Estimators of the frame error by name: those without a network, and trained ones from their weights.

PyTorch is imported only where a trained one is asked for.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rendezvous.alignment.estimate import FrameErrorEstimator
from rendezvous.alignment.window import SearchRange
from rendezvous.baselines.correlative import CorrelativeSearch
from rendezvous.baselines.hough import HoughSpectrum
from rendezvous.baselines.identity import Identity
from rendezvous.baselines.orb import OrbRansac
from rendezvous.errors import ConfigError, StoreError, needs_extra
from rendezvous.evaluation.frame_error.measured_row import Training
from rendezvous.evaluation.frame_error.table_one import LEARNED, METHODS, model_of
from rendezvous.evaluation.frame_error.training_curve import TrainingCurve
from rendezvous.resources import WEIGHTS
from rendezvous.store.disk import Disk

if TYPE_CHECKING:
    from rendezvous.stages.weights.trained_estimators import Trained

RUNS = Path("runs")
CURVE = "curve.json"
"""Beside weights that do not tell their curve themselves, as `train` leaves it, or NAME.curve.json."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Method:
    """One method that is to be measured.

    Attributes:
        name: of `METHODS`.
        search: where to look for the frame error, for those that search.
        weights: of a trained one; None for the others.
    """

    name: str
    search: SearchRange
    weights: Path | None = None

    @property
    def learned(self) -> bool:
        """Whether it needs weights."""
        return self.name in LEARNED

    def weights_digest(self) -> str:
        """Of the file; empty for a method without."""
        return "" if self.weights is None else hashlib.sha256(_bytes(self.weights)).hexdigest()


def chosen_methods(
    names: tuple[str, ...], weights: Mapping[str, Path], *, xy_range_m: float, yaw_range_rad: float
) -> list[Method]:
    """The methods to measure, in the order of tables.

    Args:
        names: of `METHODS`; none for all that need no weights or have some.
        weights: where those of some methods lie; for the others `runs/NAME`, then the shipped ones.
        xy_range_m, yaw_range_rad: half widths of the frame errors.

    Raises:
        ConfigError: there is no such method, or no weights for it.
    """
    for name in (*names, *weights):
        if name not in METHODS:
            raise ConfigError(f"method {name!r} is unknown; must be one of {', '.join(METHODS)}")
    for name in weights:
        if name not in LEARNED:
            raise ConfigError(
                f"--weights {name}=...: {name} has no weights; those have: {', '.join(LEARNED)}"
            )
    search = SearchRange.covering(xy_m=xy_range_m, yaw_rad=yaw_range_rad)
    out = []
    for name in METHODS:
        path = weights.get(name) or weights.get(model_of(name)) or _found_weights(name)
        if name in names and name in LEARNED and path is None:
            places = " or ".join(str(place) for place in _weight_places(name))
            raise ConfigError(
                f"{name}: no weights in {places}; `rendezvous train --model {model_of(name)}` makes "
                f"them, --weights {name}=PATH names others"
            )
        runs_unasked = path is not None or name not in LEARNED
        if name in names or (not names and runs_unasked):
            out.append(Method(name=name, search=search, weights=path))
    return out


def baseline(method: Method) -> FrameErrorEstimator:
    """A method without a network."""
    match method.name:
        case "identity":
            return Identity()
        case "hough":
            return HoughSpectrum(search=method.search)
        case "hough-global":
            return HoughSpectrum()
        case "orb":
            return OrbRansac()
        case _:
            assert method.name == "correlative", method.name
            return CorrelativeSearch(search=method.search)


def trained(method: Method, *, threads: int) -> Trained:
    """A method with a network, from its weights.

    Raises:
        SetupError: PyTorch is not installed.
        StoreError: the weights are missing or damaged.
        ConfigError: they are another model's.
    """
    with needs_extra("fuse", method.name):
        from rendezvous.stages.weights.trained_estimators import load
    assert method.weights is not None
    return load(
        _bytes(method.weights), method.name, method.search, where=str(method.weights), threads=threads
    )


def training_of(method: Method, record: Mapping[str, Any]) -> Training:
    """How a trained method came about.

    Args:
        method: with weights.
        record: what the weights' file tells of it.

    Raises:
        StoreError: the curve beside the weights is damaged, or the record is of something else.
    """
    assert method.weights is not None
    try:
        curve = _curve(method.weights, record)
        data = record["data"]
        return Training(
            seed=record["seed"],
            samples=record["samples"],
            minutes=None if curve is None else curve.minutes,
            data=data["folder"],
            pairs=data["pairs"]["train"],
            plans=data["plans"]["train"],
            weights_digest=method.weights_digest(),
            curve=curve,
        )
    except (KeyError, TypeError) as error:
        raise StoreError(
            f"{method.weights}: does not tell how it was trained ({error}); must be what train writes"
        ) from error


def plans_trained_on(record: Mapping[str, Any], plans: Mapping[str, str]) -> int | None:
    """How many floor plans a trained method knows from its training; None if its record does not tell.

    Args:
        record: what the weights' file tells of it; holds the first digits of the digests of its plans.
        plans: digests by the plan's id.
    """
    known = record["data"].get("plan_digests")
    return None if known is None else sum(trained_on(record, digest) for digest in plans.values())


def trained_on(record: Mapping[str, Any], plan_digest: str) -> bool:
    """Whether a trained method's record names this floor plan."""
    return plan_digest.startswith(tuple(record.get("data", {}).get("plan_digests") or ()))


def _curve(weights: Path, record: Mapping[str, Any]) -> TrainingCurve | None:
    """That the weights tell, or else the one beside them, if it is of the run that they are from."""
    if points := record.get("curve"):
        return TrainingCurve.from_points(points)
    path = next(
        (p for p in (weights.with_suffix(".curve.json"), weights.parent / CURVE) if p.is_file()), None
    )
    if path is None:
        return None
    try:
        told = json.loads(_bytes(path))
        if any(told[key] != record[key] for key in ("model", "seed", "samples", "data")):
            return None
        return TrainingCurve.from_points(told["curve"])
    except (ValueError, KeyError, TypeError) as error:
        raise StoreError(f"{path}: no curve of a training run ({error}); train writes it anew") from error


def _found_weights(name: str) -> Path | None:
    return next((place for place in _weight_places(name) if place.is_file()), None)


def _weight_places(name: str) -> tuple[Path, ...]:
    if name not in LEARNED:
        return ()
    model = model_of(name)
    return RUNS / model / "weights.safetensors", WEIGHTS / f"{model}.safetensors"


def _bytes(path: Path) -> bytes:
    return Disk(str(path.parent)).read(path.name)
