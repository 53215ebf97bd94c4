"""Files of others in YAML, read with errors of one line."""

from __future__ import annotations

import math
import reprlib
from pathlib import Path
from typing import Any

import yaml

from rendezvous.errors import PipelineError
from rendezvous.interop.given_file import given_bytes

MOST_BYTES = 10_000_000
"""PyYAML takes a minute for so much, and a whole bag of messages is none of these files."""

_SHOWN_LETTERS = 100


def read_yaml_fields(path: Path, error: type[PipelineError], *, right: str) -> dict[str, Any]:
    """The keys and values of a YAML file's first document.

    Args:
        path: the file, in UTF-8.
        error: what to raise.
        right: what the file should hold, for the error's text.

    Raises:
        PipelineError: of the given type; the file cannot be read, is no YAML, or holds no keys.
    """
    try:
        # `ros2 topic echo` ends every message with `---`: what follows is another document, or none.
        text = given_bytes(path, most_bytes=MOST_BYTES).decode("utf-8")
        fields = next(iter(yaml.safe_load_all(text)), None)
    except (OSError, ValueError, RecursionError, yaml.YAMLError) as cause:
        why = cause.strerror if isinstance(cause, OSError) else " ".join(str(cause).split())
        raise error(f"{path}: cannot be read as YAML ({why}); must be {right}") from cause
    if not isinstance(fields, dict):
        raise error(f"{path}: holds no keys; must be {right}")
    return fields


def number(value: Any) -> float | None:
    """A finite number, also as text: PyYAML takes `1e-05` for one. None for anything else."""
    if isinstance(value, str):
        try:
            value = float(value)
        except ValueError:
            return None
    if isinstance(value, bool) or not isinstance(value, int | float):
        return None
    try:
        return float(value) if math.isfinite(value) else None
    except OverflowError:
        return None


def numbers(value: Any) -> list[float] | None:
    """A list of finite numbers; None if it is none."""
    if not isinstance(value, list):
        return None
    read = [number(item) for item in value]
    return None if None in read else [item for item in read if item is not None]


def short(value: Any) -> str:
    """A value as an error shows it: one line, cut where it is long."""
    text = reprlib.repr(value)
    return text if len(text) <= _SHOWN_LETTERS else f"{text[:_SHOWN_LETTERS]} ..."
