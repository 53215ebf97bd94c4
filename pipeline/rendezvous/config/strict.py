"""Strict configuration: known keys only, faults named in one line, and safe YAML without two of its traps: a
repeated key is an error, and 1e-3 is a number."""

from __future__ import annotations

import dataclasses
import difflib
import json
import re
from collections.abc import Hashable, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar, get_args, get_origin, get_type_hints

import yaml
from pydantic import BaseModel, ConfigDict, ValidationError

from rendezvous.errors import ConfigError, PipelineError
from rendezvous.interop.bounded_yaml import BoundedLoader, FaultyYamlError, load_document
from rendezvous.interop.given_file import given_bytes

Validated = TypeVar("Validated", bound=BaseModel)
Layers = Mapping[str, Mapping[str, Any]]

_MOST_BYTES = 1_000_000
_MERGE = "tag:yaml.org,2002:merge"
_UNKNOWN_KEY = ("extra_forbidden", "unexpected_keyword_argument")
_MISSING_KEY = ("missing", "missing_argument", "missing_keyword_only_argument")
_MOVED = {
    "explore.episode.lidar_noise": "lidar.noise of the robot file",
    "explore.episode.slam.range_sigma_m": "lidar.noise.sigma_m of the robot file",
    "explore.episode.slam.range_sigma_ratio": "lidar.noise.sigma_ratio of the robot file",
    "explore.episode.slam.mapping.no_echo_free_m": "lidar.no_echo_free_m of the robot file",
    "explore.start_clearance_m": "explore.start_margin_m, which is added to the robot's radius",
    "explore.episode.explorer.hard_clearance_m": "hard_margin_m, which is added to the robot's radius",
    "explore.episode.explorer.soft_clearance_m": "soft_margin_m, which is added to the robot's radius",
    "explore.episode.explorer.clear_m": "clear_margin_m, which is added to the robot's radius",
    "floorplans.limits.robot_radius_m": "radius_m of the robot file that floorplans.robot names",
    "floorplans.limits.margin_m": "nothing: the margin is fixed",
}
"""Keys of earlier versions, and what replaced them."""


class Section(BaseModel):
    """A strict part of a configuration: unknown keys, wrong types and infinite numbers are errors.

    Frozen dataclasses of the rooms can be fields; the same holds for them.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)


def validated_section(
    section: type[Validated], values: Mapping[str, Any], *, file: str, layers: Layers | None = None
) -> Validated:
    """The section with these values.

    Args:
        section: its type.
        values: as YAML gives them.
        file: where they were read.
        layers: by name, lowest first, the values that were laid over each other to get `values`. The top one
            that holds a faulty key is named in the error.

    Raises:
        ConfigError: a key is unknown or missing, or a value is wrong.
    """
    try:
        # Strict mode takes a list for a tuple only from JSON.
        return section.model_validate_json(json.dumps(values))
    except ValidationError as error:
        raise ConfigError(_explained(error, section, file, layers or {})) from error
    except PipelineError as error:  # a room's own contract
        raise ConfigError(f"{file}: {error}") from error
    except TypeError as error:
        raise ConfigError(f"{file}: {error}; values must be numbers, texts, lists and mappings") from error


def _explained(error: ValidationError, section: type[BaseModel], file: str, layers: Layers) -> str:
    """The first fault, and how many more there are."""
    # An unknown key often is a misspelt one, and then another is missing for it.
    faults = sorted(error.errors(include_url=False), key=lambda fault: fault["type"] not in _UNKNOWN_KEY)
    more = f" (and {len(faults) - 1} more)" if len(faults) > 1 else ""
    return _fault_line(faults[0], section, file, layers) + more


def _fault_line(fault: Any, section: type[BaseModel], file: str, layers: Layers) -> str:
    path = fault["loc"]
    key = ".".join(map(str, path))
    where = next((name for name, values in reversed(list(layers.items())) if _holds(values, path)), file)
    if key in _MOVED:
        return f"{where}: key {key!r} is gone; it is now {_MOVED[key]}"
    if fault["type"] in _UNKNOWN_KEY:
        return f"{where}: unknown key {key!r:.100}; {_nearest(path, _known_keys(section, path[:-1]))}"
    if fault["type"] in _MISSING_KEY:
        return f"{where}: key {key!r} is missing"
    return f"{where}: {key} is {fault['input']!r:.60}; {fault['msg'].replace('Input should', 'must')}"


def _holds(values: Any, path: Sequence[str | int]) -> bool:
    for key in path:
        if isinstance(key, int):
            return isinstance(values, Sequence)
        if not isinstance(values, Mapping) or key not in values:
            return False
        values = values[key]
    return True


def _known_keys(model: Any, path: Sequence[str | int]) -> list[str]:
    """The keys of the part at a path; parts are pydantic models or dataclasses."""
    for key in path:
        model = get_args(model)[1] if get_origin(model) is dict else _field_types(model)[str(key)]
    return list(_field_types(model))


def _field_types(model: Any) -> dict[str, Any]:
    if issubclass(model, BaseModel):
        return {name: field.annotation for name, field in model.model_fields.items()}
    hints = get_type_hints(model)
    return {field.name: hints[field.name] for field in dataclasses.fields(model)}


def _nearest(path: Sequence[str | int], known: Sequence[str]) -> str:
    near = difflib.get_close_matches(str(path[-1]), known, n=1, cutoff=0.5)
    if not near:
        return f"known keys are {', '.join(known)}"
    return f"the nearest known key is {'.'.join(map(str, (*path[:-1], near[0])))!r}"


class _Loader(BoundedLoader):
    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        seen: set[Any] = set()
        for key_node, _ in node.value if isinstance(node, yaml.MappingNode) else ():
            line = key_node.start_mark.line + 1
            if key_node.tag == _MERGE:
                raise FaultyYamlError("a merge key (<<) is not read here; write its keys out", line=line)
            key = self.construct_object(key_node, deep=True)
            if not isinstance(key, Hashable):
                raise FaultyYamlError(f"{key!r:.60} cannot be a key", line=line)
            if key in seen:
                raise FaultyYamlError(f"key {key!r:.60} is given twice", line=line)
            seen.add(key)
        return super().construct_mapping(node, deep=deep)


# YAML 1.1 requires a dot and a signed exponent; users write 1e-3 and mean a number.
_Loader.add_implicit_resolver(
    "tag:yaml.org,2002:float", re.compile(r"^[-+]?[0-9]+(\.[0-9]*)?[eE][-+]?[0-9]+$"), list("-+0123456789")
)


def load_file(path: str | Path, *, right: str) -> dict[str, Any]:
    """The mapping that a YAML file holds.

    Raises:
        ConfigError: there is no such file, or it is not a YAML mapping.
    """
    try:
        text = given_bytes(Path(path), most_bytes=_MOST_BYTES).decode("utf-8")
    except OSError as error:
        raise ConfigError(f"{path}: {(error.strerror or str(error)).lower()}; must be {right}") from error
    except UnicodeDecodeError as error:
        raise ConfigError(f"{path}: not text in UTF-8 ({error.reason}); must be {right}") from error
    content = load_value(text, where=str(path))
    if not isinstance(content, dict):
        found = "nothing" if content is None else f"{content!r:.40}"
        raise ConfigError(f"{path}: holds {found}; must be {right}")
    return content


def load_value(text: str, *, where: str) -> Any:
    """One value written as YAML.

    Raises:
        ConfigError: it is not YAML, or larger or deeper than any configuration; see `bounded_yaml`.
    """
    try:
        return load_document(text, _Loader, more_may_follow=False)
    except FaultyYamlError as error:
        line = f":{error.line}" if error.line is not None and "\n" in text else ""
        raise ConfigError(f"{where}{line}: {error.what}") from error
