"""A model's configuration from what `stages.yaml` sets of it."""

from __future__ import annotations

import dataclasses
import difflib
from collections.abc import Collection, Mapping
from typing import Any, TypeVar

from rendezvous.errors import ConfigError

Record = TypeVar("Record")


def filled(
    config: type[Record],
    settings: Mapping[str, Any],
    *,
    where: str,
    model: str,
    fixed: Mapping[str, Any],
    follows: Collection[str] = (),
) -> Record:
    """A model's configuration with what is fixed, and with these settings.

    Args:
        config: the configuration's class; every field has a default.
        settings: those that are not to be the default.
        where: for messages: `train.settings`.
        model: for messages.
        fixed: what the model's name or the samples decide.
        follows: fields that may not be set, as they follow from other settings.

    Raises:
        ConfigError: a setting is fixed, unknown (names the nearest known), of another type, or has no use.
    """
    section = where.partition(".")[0]
    defaults = {field.name: field.default for field in dataclasses.fields(config)}  # type: ignore[arg-type]
    known = [key for key in defaults if key not in follows]
    for key, value in settings.items():
        if key in defaults and key in follows:
            raise ConfigError(
                f"{where}: {key} is {value!r}; must be left out, as it follows from {section}.model and "
                f"{section}.sampling"
            )
        if key not in known:
            near = difflib.get_close_matches(key, known, n=1, cutoff=0.5)
            right = f"the nearest known is {near[0]!r}" if near else f"known are {', '.join(known)}"
            raise ConfigError(f"{where}: {model} has no {key!r}; {right}")
        if not _is_like(value, defaults[key]):
            raise ConfigError(f"{where}: {key} of {model} is {value!r}; must be like {defaults[key]!r}")
    given = {key: tuple(value) if isinstance(value, list) else value for key, value in settings.items()}
    try:
        return config(**fixed, **given)
    except ConfigError as error:
        raise ConfigError(f"{where}: {error}") from error


def _is_like(value: Any, default: Any) -> bool:
    if isinstance(default, bool) or isinstance(value, bool):
        return isinstance(value, bool) and isinstance(default, bool)
    if isinstance(default, float):
        return isinstance(value, int | float)
    if isinstance(default, tuple):
        return isinstance(value, list | tuple) and all(_is_like(item, default[0]) for item in value)
    return isinstance(value, type(default))
