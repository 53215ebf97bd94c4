"""YAML files of other programs, read as leniently as yaml-cpp reads them, with one-line errors."""

from __future__ import annotations

import codecs
import math
import reprlib
from pathlib import Path
from typing import Any

import yaml

from rendezvous.errors import PipelineError
from rendezvous.interop.bounded_yaml import BoundedLoader, FaultyYamlError, load_document
from rendezvous.interop.given_file import given_bytes

MOST_BYTES = 10_000_000
"""A larger file is something else, such as a bag of messages; of a smaller one the first document is read."""

_SHOWN_LETTERS = 100


class _Loader(BoundedLoader):
    """Ignores tags that are not YAML's own, such as OpenCV's, and what makes a date, as yaml-cpp does."""

    HALF_CHARACTERS = True


def _as_written(loader: _Loader, node: yaml.Node) -> Any:
    if isinstance(node, yaml.MappingNode):
        return loader.construct_mapping(node, deep=True)
    sequence = isinstance(node, yaml.SequenceNode)
    return loader.construct_sequence(node, deep=True) if sequence else loader.construct_scalar(node)


for _tag in (None, "tag:yaml.org,2002:timestamp"):
    _Loader.add_constructor(_tag, _as_written)


def read_yaml_fields(path: Path, error: type[PipelineError], *, right: str) -> dict[str, Any]:
    """Keys and values of the first document in a YAML file.

    Args:
        path: the file, in UTF-8, or UTF-16 as PowerShell writes it; tabs count as spaces.
        error: type of the error to raise.
        right: what the file should hold, for the error's text.

    Raises:
        PipelineError: of that type; the file cannot be read, is not YAML, or holds no keys.
    """
    try:
        # `ros2 topic echo` ends every message with `---`, so more documents may follow.
        data = given_bytes(path, most_bytes=MOST_BYTES)
        wide = data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE))
        text = data.decode("utf-16" if wide else "utf-8", errors="replace").replace("\t", " ")
        fields = load_document(text, _Loader, more_may_follow=True)
    except (OSError, UnicodeError, FaultyYamlError) as cause:
        why = cause.strerror if isinstance(cause, OSError) else " ".join(str(cause).split())
        raise error(f"{path}: cannot be read as YAML ({why}); must be {right}") from cause
    if not isinstance(fields, dict):
        raise error(f"{path}: holds no keys; must be {right}")
    return fields


def number(value: Any) -> float | None:
    """The value as a finite number, also if it is text (PyYAML reads `1e-05` as text); otherwise None."""
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
    """The value as a list of finite numbers; None if it is not one."""
    if not isinstance(value, list):
        return None
    read = [number(item) for item in value]
    return None if None in read else [item for item in read if item is not None]


def short(value: Any) -> str:
    """The value on one line for an error message, shortened if it is long."""
    text = reprlib.repr(value)
    return text if len(text) <= _SHOWN_LETTERS else f"{text[:_SHOWN_LETTERS]} ..."
