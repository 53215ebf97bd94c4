"""Parts of a configuration that take nothing but what they know, and say what is wrong in one line."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any, TypeVar

from pydantic import BaseModel, ConfigDict, ValidationError

from rendezvous.config.errors import explained
from rendezvous.errors import ConfigError, PipelineError

Validated = TypeVar("Validated", bound=BaseModel)


class Section(BaseModel):
    """A strict part of a configuration: unknown keys, wrong types and infinite numbers are errors.

    Frozen dataclasses of the rooms can be fields; they are held to the same.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)


def validated_section(
    section: type[Validated],
    values: Mapping[str, Any],
    *,
    file: str,
    layers: Mapping[str, Mapping[str, Any]] | None = None,
) -> Validated:
    """The section that the values fill.

    Args:
        section: its type.
        values: as YAML gives them.
        file: where they were read.
        layers: what was laid over what to get them, by its name, lowest first.

    Raises:
        ConfigError: a key is unknown or missing, or a value is wrong.
    """
    try:
        # Strict mode takes a list for a tuple only from JSON.
        return section.model_validate_json(json.dumps(values))
    except ValidationError as error:
        raise ConfigError(explained(error, section, file=file, layers=layers or {})) from error
    except PipelineError as error:  # a room's own contract
        raise ConfigError(f"{file}: {error}") from error
    except TypeError as error:
        raise ConfigError(f"{file}: {error}; values must be numbers, texts, lists and mappings") from error
