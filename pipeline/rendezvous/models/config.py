"""The config of a network (its shape) as plain values: in the record of its weights, and as stages.yaml
sets it."""

from __future__ import annotations

import dataclasses
import difflib
from collections.abc import Collection, Mapping
from typing import Any, Self

from rendezvous.errors import ConfigError

_LARGEST = 10_000  # of any whole number: of layers, cells or channels


class Config:
    """A frozen dataclass of plain values that all have defaults."""

    __slots__ = ()

    def as_dict(self) -> dict[str, Any]:
        """Values by field, as JSON holds them."""
        values = dataclasses.asdict(self)  # type: ignore[call-overload]
        return {key: list(value) if isinstance(value, tuple) else value for key, value in values.items()}

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> Self:
        """Inverse of `as_dict`.

        Raises:
            ConfigError: a field is missing or unknown, or has no valid value.
        """
        defaults = cls._defaults()
        wrong = sorted(values.keys() ^ defaults.keys()) or [
            key for key, value in values.items() if not _is_like(value, defaults[key])
        ]
        if wrong:
            found = repr(values[wrong[0]]) if wrong[0] in values else "absent"
            right = (
                f"like {defaults[wrong[0]]!r}" if wrong[0] in defaults else f"one of {', '.join(defaults)}"
            )
            raise ConfigError(f"{cls.__name__}: {wrong[0]} is {found}; must be {right}")
        return cls(**_with_tuples(values))

    @classmethod
    def with_settings(
        cls,
        settings: Mapping[str, Any],
        *,
        where: str,
        model: str,
        fixed: Mapping[str, Any],
        follows: Collection[str] = (),
    ) -> Self:
        """The defaults, changed by what is fixed and by these settings.

        The model's name or the samples decide the `fixed` fields; those in `follows` may not be set, because
        they follow from other parameters. `where` (such as `train.settings`) and `model` are for messages.

        Raises:
            ConfigError: a setting is fixed, unknown (names the nearest known), of another type, or invalid.
        """
        section, defaults = where.partition(".")[0], cls._defaults()
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
        try:
            return cls(**fixed, **_with_tuples(settings))
        except ConfigError as error:
            raise ConfigError(f"{where}: {error}") from error

    @classmethod
    def _defaults(cls) -> dict[str, Any]:
        return {field.name: field.default for field in dataclasses.fields(cls)}  # type: ignore[arg-type]


def _with_tuples(values: Mapping[str, Any]) -> dict[str, Any]:
    return {key: tuple(value) if isinstance(value, list) else value for key, value in values.items()}


def _is_like(value: Any, default: Any) -> bool:
    if isinstance(default, bool) or isinstance(value, bool):
        return isinstance(value, bool) and isinstance(default, bool)
    if isinstance(default, float):
        return isinstance(value, int | float)
    if isinstance(default, tuple):
        return isinstance(value, list | tuple) and all(_is_like(item, default[0]) for item in value)
    if isinstance(value, int) and abs(value) > _LARGEST:
        return False
    return isinstance(value, type(default))
