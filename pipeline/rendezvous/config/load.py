"""Load `stages.yaml`: what each stage reads and writes, its parameters, the presets."""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any

from rendezvous.config.sections import Parameters
from rendezvous.config.stage_table import STAGES
from rendezvous.config.strict import Section, load_file, load_value, validated_section
from rendezvous.errors import ConfigError
from rendezvous.interop.bounded_yaml import MOST_LEVELS

_RIGHT = "a YAML mapping with seed, stages and presets; --config FILE names another"
_SHOWN_LETTERS = 200
_FOLDER_PATTERN = re.compile(r"[a-z0-9][a-z0-9_-]*")


class StageLinks(Section):
    """The stages that a stage reads, the folder that it writes, and its parameters."""

    reads: tuple[str, ...]
    writes: str
    parameters: dict[str, Any]


class _StagesFile(Section):
    seed: int
    stages: dict[str, StageLinks]
    presets: dict[str, dict[str, dict[str, Any] | None] | None]


class Config(Parameters):
    """Everything that decides what the pipeline makes."""

    stages: dict[str, StageLinks]  # the stages' entries in flow order


def load_config(
    path: str | Path, *, preset: str = "default", overrides: Collection[str] = (), seed: int | None = None
) -> Config:
    """Read `stages.yaml`.

    Args:
        path: the file.
        preset: name of the preset that overrides the stages' parameters.
        overrides: such as `explore.episodes_per_plan=10` or `seed=3`; values are YAML; the last one wins.
        seed: root seed; None for the file's.

    Raises:
        ConfigError: a key is unknown or a value is wrong; says where, what was found and what is right.
    """
    file = validated_section(_StagesFile, load_file(path, right=_RIGHT), file=str(path))
    _check_flow(file.stages, str(path))
    layers: dict[str, Mapping[str, Any]] = {
        f"{path}: stages": {name: stage.parameters for name, stage in file.stages.items()},
        f"{path}: presets.{preset}": _preset(file, preset, str(path)),
    }
    layers |= {_shown(override): _override(override) for override in overrides}
    if seed is not None:
        layers[f"--seed {seed}"] = {"seed": seed}
    values: dict[str, Any] = {"seed": file.seed}
    for layer in layers.values():
        values = _overlaid(values, layer)
    parameters = validated_section(Parameters, values, file=str(path), layers=layers)
    return Config(stages=file.stages, **dict(parameters))


def _check_flow(stages: Mapping[str, StageLinks], file: str) -> None:
    """Check that each stage reads what its code reads, follows those stages, and has its own folder.

    An unknown stage is found later, by its parameters.
    """
    known: list[str] = []
    folders: dict[str, str] = {}
    for name, stage in stages.items():
        if not _FOLDER_PATTERN.fullmatch(stage.writes):
            raise ConfigError(
                f"{file}: stages.{name}.writes is {stage.writes!r:.60}; must be one folder's plain name: "
                "small letters, digits, '-' and '_'"
            )
        entry = STAGES.get(name)
        shared = entry is not None and (entry.beside_data or entry.apart)
        if not shared and (other := folders.setdefault(stage.writes, name)) != name:
            raise ConfigError(
                f"{file}: stages.{name}.writes is {stage.writes!r}, as is {other}'s; each stage needs its own"
            )
        if entry is not None and set(stage.reads) != set(entry.reads):
            raise ConfigError(
                f"{file}: stages.{name}.reads is {list(stage.reads)}; must be {list(entry.reads)}, "
                "which is what its code reads"
            )
        for upstream in stage.reads:
            if upstream not in known:
                above = ", ".join(known) or "none"
                raise ConfigError(
                    f"{file}: stages.{name}.reads has {upstream!r}; the stages above it are {above}"
                )
        known.append(name)


def _preset(file: _StagesFile, preset: str, path: str) -> dict[str, Any]:
    if preset not in file.presets:
        raise ConfigError(f"{path}: no preset {preset!r}; presets are {', '.join(file.presets)}")
    return {stage: values or {} for stage, values in (file.presets[preset] or {}).items()}


def _override(text: str) -> dict[str, Any]:
    key, equals, value = text.partition("=")
    names = key.split(".")
    named = all(name and name.isprintable() for name in names)  # half a character is not printable
    if not equals or not named or len(names) > MOST_LEVELS:
        raise ConfigError(f"{_shown(text)}: must be KEY=VALUE, such as explore.episodes_per_plan=10")
    nested: Any = load_value(value, where=_shown(text))
    for name in reversed(names):
        nested = {name: nested}
    return dict(nested)


def _shown(override: str) -> str:
    """The option as it fits on the one line of a message."""
    line = " ".join(override[: _SHOWN_LETTERS + 1].split())
    return f"--set {line}" if len(override) <= _SHOWN_LETTERS else f"--set {line[:_SHOWN_LETTERS]}..."


def _overlaid(values: Mapping[str, Any], layer: Mapping[str, Any]) -> dict[str, Any]:
    merged = dict(values)
    for key, value in layer.items():
        below = merged.get(key)
        if isinstance(below, Mapping) and isinstance(value, Mapping):
            value = _overlaid(below, value)
        merged[key] = value
    return merged
