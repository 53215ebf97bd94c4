"""What is wrong with a configuration, in one line: where, which value, and what would be right."""

from __future__ import annotations

import dataclasses
import difflib
from collections.abc import Mapping, Sequence
from typing import Any, get_args, get_origin, get_type_hints

from pydantic import BaseModel, ValidationError

Path = tuple[str | int, ...]
_UNKNOWN_KEY = ("extra_forbidden", "unexpected_keyword_argument")
_MISSING_KEY = ("missing", "missing_argument", "missing_keyword_only_argument")


def explained(
    error: ValidationError, model: type[BaseModel], *, file: str, layers: Mapping[str, Mapping[str, Any]]
) -> str:
    """The first fault in one line, and how many more there are.

    Args:
        error: what pydantic found.
        model: what it checked against.
        file: where the values were read.
        layers: what was laid over what, by its name, lowest first: the top one that holds a key is to blame.
    """
    # An unknown key often is a misspelt one, and then another is missing for it.
    faults = sorted(error.errors(include_url=False), key=lambda fault: fault["type"] not in _UNKNOWN_KEY)
    more = f" (and {len(faults) - 1} more)" if len(faults) > 1 else ""
    return _fault_line(faults[0], model, file, layers) + more


def _fault_line(
    fault: Any, model: type[BaseModel], file: str, layers: Mapping[str, Mapping[str, Any]]
) -> str:
    path: Path = fault["loc"]
    where = _origin(path, file, layers)
    key = ".".join(map(str, path))
    if fault["type"] in _UNKNOWN_KEY:
        known = _known_keys(model, path[:-1])
        return f"{where}: unknown key {key!r}; {_nearest(str(path[-1]), known)}"
    if fault["type"] in _MISSING_KEY:
        return f"{where}: key {key!r} is missing"
    return f"{where}: {key} is {fault['input']!r:.60}; {fault['msg'].replace('Input should', 'must')}"


def _origin(path: Path, file: str, layers: Mapping[str, Mapping[str, Any]]) -> str:
    for name, values in reversed(list(layers.items())):
        if _holds(values, path):
            return name
    return file


def _holds(values: Any, path: Path) -> bool:
    for key in path:
        if isinstance(key, int):
            return isinstance(values, Sequence)
        if not isinstance(values, Mapping) or key not in values:
            return False
        values = values[key]
    return True


def _known_keys(model: Any, path: Path) -> list[str]:
    """The keys of the section at a path: of a model, or of a room's dataclass."""
    for key in path:
        model = _type_below(model, str(key))
    return list(_field_types(model))


def _type_below(model: Any, key: str) -> Any:
    return get_args(model)[1] if get_origin(model) is dict else _field_types(model)[key]


def _field_types(model: Any) -> dict[str, Any]:
    if issubclass(model, BaseModel):
        return {name: field.annotation for name, field in model.model_fields.items()}
    hints = get_type_hints(model)
    return {field.name: hints[field.name] for field in dataclasses.fields(model)}


def _nearest(key: str, known: Sequence[str]) -> str:
    near = difflib.get_close_matches(key, known, n=1, cutoff=0.5)
    return f"the nearest known key is {near[0]!r}" if near else f"known keys are {', '.join(known)}"
