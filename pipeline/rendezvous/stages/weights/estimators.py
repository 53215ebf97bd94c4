"""Methods that are ready to be used: with the search they run over, and a network with its weights.

PyTorch is imported only where a network is asked for.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

from rendezvous.alignment.window import DEFAULT_SEARCH, SearchRange
from rendezvous.errors import ConfigError, StoreError, needs_extra
from rendezvous.evaluation.frame_error.training_curve import Training, TrainingCurve
from rendezvous.methods import Method, installed_methods, method_at
from rendezvous.resources import WEIGHTS
from rendezvous.store.disk import Disk

if TYPE_CHECKING:
    from rendezvous.stages.weights.trained_estimators import Trained

RUNS = Path("runs")
CURVE = "curve.json"
"""The training curve beside weights that do not hold it themselves; `train` writes it, or NAME.curve.json."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SelectedMethod:
    """A method that is to be used, with all it needs."""

    method: Method
    search: SearchRange
    weights: Path | None = None  # file of a network's weights; None for a method without

    @property
    def name(self) -> str:
        return self.method.name

    def weights_digest(self) -> str:
        """SHA-256 of the weights file, or '' if the method has none."""
        return "" if self.weights is None else hashlib.sha256(_bytes(self.weights)).hexdigest()


def select_methods(
    names: Sequence[str],
    weights: Mapping[str, Path],
    *,
    search: SearchRange,
    own: Mapping[str, Method] = MappingProxyType({}),
) -> list[SelectedMethod]:
    """The methods to measure, in the order of tables.

    Args:
        names: of shipped or installed methods, of `own`, or `package.module:Class`; none for all that need no
            weights or whose weights are found.
        weights: files of some networks' weights; the others are looked for in `runs/NAME`, then among the
            shipped ones.
        search: from which frame errors are drawn.
        own: further methods by name; they always run.

    Raises:
        ConfigError: a method or the weights for it do not exist, or it has no weights.
    """
    at_paths = [method_at(name, number=number) for number, name in enumerate(n for n in names if ":" in n)]
    known = {**installed_methods(), **{method.name: method for method in at_paths}, **own}
    asked = {*(name for name in names if ":" not in name), *(method.name for method in at_paths), *own}
    for name in (*asked, *weights):
        if name not in known:
            raise ConfigError(f"method {name!r} is unknown; must be one of {', '.join(known)}")
    for name in weights:
        if not known[name].needs_weights:
            learned = ", ".join(method.name for method in known.values() if method.needs_weights)
            raise ConfigError(f"--weights {name}=...: {name} has no weights; those have: {learned}")
    selected = []
    for name, method in known.items():
        places = _weight_places(method)
        found = next((place for place in places if place.is_file()), None)
        path = weights.get(name) or weights.get(method.model) or found
        lacks_weights = method.needs_weights and path is None
        if name in asked and lacks_weights:
            raise ConfigError(
                f"{name}: no weights in {' or '.join(map(str, places))}; "
                f"`rendezvous train --model {method.model}` makes them, --weights {name}=PATH names others"
            )
        if name in asked or (not names and not lacks_weights):
            selected.append(SelectedMethod(method=method, search=search, weights=path))
    return selected


def selected_matcher() -> SelectedMethod:
    """The matcher with its weights from `runs/matcher`, or else the shipped ones.

    Raises:
        ConfigError: there are none.
    """
    (matcher,) = select_methods(("matcher",), {}, search=DEFAULT_SEARCH)
    return matcher


def trained(selected: SelectedMethod, *, threads: int) -> Trained:
    """The network of a method, from its weights.

    Raises:
        SetupError: PyTorch is not installed.
        StoreError: the weights are missing or damaged.
        ConfigError: they are another model's.
    """
    with needs_extra("fuse", selected.name):
        from rendezvous.stages.weights.trained_estimators import load
    assert selected.weights is not None
    data, where = _bytes(selected.weights), str(selected.weights)
    return load(data, selected.name, selected.search, where=where, threads=threads)


def training_of(selected: SelectedMethod, record: Mapping[str, Any]) -> Training:
    """The training of a network.

    Raises:
        StoreError: the curve beside the weights is damaged, or the record is of something else.
    """
    assert selected.weights is not None
    try:
        curve = _curve(selected.weights, record)
        data = record["data"]
        return Training(
            seed=record["seed"],
            samples=record["samples"],
            minutes=None if curve is None else curve.minutes,
            data=data["folder"],
            pairs=data["pairs"]["train"],
            plans=data["plans"]["train"],
            weights_digest=selected.weights_digest(),
            curve=curve,
        )
    except (KeyError, TypeError) as error:
        raise StoreError(
            f"{selected.weights}: no record of its training ({error}); must be a file that train wrote"
        ) from error


def plans_trained_on(record: Mapping[str, Any], plans: Mapping[str, str]) -> int | None:
    """How many of the floor plans a network was trained on; None if its record does not say."""
    known = record["data"].get("plan_digests")
    return None if known is None else sum(trained_on(record, digest) for digest in plans.values())


def trained_on(record: Mapping[str, Any], plan_digest: str) -> bool:
    """Whether a trained method's record names this floor plan."""
    return plan_digest.startswith(tuple(record.get("data", {}).get("plan_digests") or ()))


def _curve(weights: Path, record: Mapping[str, Any]) -> TrainingCurve | None:
    """The curve in the weights' record, or else the one beside them, if it is from the same run."""
    if points := record.get("curve"):
        return TrainingCurve.from_points(points)
    path = next(
        (p for p in (weights.with_suffix(".curve.json"), weights.parent / CURVE) if p.is_file()), None
    )
    if path is None:
        return None
    try:
        kept = json.loads(_bytes(path))
        if any(kept[key] != record[key] for key in ("model", "seed", "samples", "data")):
            return None
        return TrainingCurve.from_points(kept["curve"])
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        raise StoreError(f"{path}: no curve of a training run ({error}); train writes it anew") from error


def _weight_places(method: Method) -> tuple[Path, ...]:
    if not method.needs_weights:
        return ()
    return RUNS / method.model / "weights.safetensors", WEIGHTS / f"{method.model}.safetensors"


def _bytes(path: Path) -> bytes:
    return Disk(str(path.parent)).read(path.name)
