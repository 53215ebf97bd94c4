"""Types of the values in JSON files, which anything may have changed."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import PurePosixPath
from typing import Any


def require_types(fields: Any, **kinds: type) -> None:
    """Check the types of some fields.

    Raises:
        KeyError, TypeError: a field is missing or of another type; says which.
    """
    if not isinstance(fields, Mapping):
        raise TypeError(f"{fields!r:.60} is no object")
    for name, kind in kinds.items():
        value = fields[name]
        if not isinstance(value, kind) or (isinstance(value, bool) and kind is not bool):
            raise TypeError(f"{name} is {value!r:.60}; must be {kind.__name__}")


def require_values(fields: Any, **kinds: type) -> None:
    """Check that fields are objects whose values all have a type.

    Raises:
        KeyError, TypeError: a field is missing or of another type; says which.
    """
    for name, kind in kinds.items():
        require_types(fields, **{name: dict})
        require_types(fields[name], **dict.fromkeys(fields[name], kind))


def require_file_name(name: str) -> None:
    """Check that a name is that of a file below the folder it is listed in.

    Raises:
        ValueError: it leads elsewhere, or is no name.
    """
    path = PurePosixPath(name)
    if not path.parts or "\0" in name or path.is_absolute() or ".." in path.parts or str(path) != name:
        raise ValueError(f"{name!r:.60} is no file below this folder")
