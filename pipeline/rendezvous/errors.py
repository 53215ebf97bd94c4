"""Errors that the user can fix.

A `PipelineError` says where, what was found and what would be right. The command line prints it as one
line and exits with 2; anything else is a bug and keeps its traceback.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager


class PipelineError(Exception):
    """Something the user can fix."""


class ConfigError(PipelineError):
    """A wrong key or value in `stages.yaml`, `--set` or a robot file."""


class FloorplanError(PipelineError):
    """A floor plan that cannot be used."""


class MapError(PipelineError):
    """An occupancy grid or map file that cannot be used."""


class SightingError(PipelineError):
    """Images or poses that do not show where one robot saw the other."""


class CameraError(PipelineError):
    """A camera description or image that cannot be used."""


class LogError(PipelineError):
    """A recorded log that cannot be read or used."""


class StoreError(PipelineError):
    """A dataset folder that is missing, damaged or cannot be written."""


class SplitError(PipelineError):
    """Splits that cannot be made from the available plans."""


class SetupError(PipelineError):
    """A package or system library that is missing."""


@contextmanager
def needs_extra(extra: str, purpose: str) -> Iterator[None]:
    """Turn a failed import of another package into a `SetupError` that names the extra to install.

    Args:
        extra: a group of optional dependencies in pyproject.toml.
        purpose: what needs it, the subject of the message.
    """
    try:
        yield
    except ModuleNotFoundError as error:
        if (error.name or "").partition(".")[0] == "rendezvous":
            raise
        raise SetupError(
            f"{purpose} needs {error.name}, which is not installed; "
            f"`pip install 'rendezvous-fusion[{extra}]'` installs it"
        ) from error


def require_within(record: object, **bounds: tuple[float, float]) -> None:
    """Check fields of a record against closed bounds.

    Raises:
        ConfigError: names the field, its value and the bounds.
    """
    for field, (low, high) in bounds.items():
        value = getattr(record, field)
        if not low <= value <= high:
            raise ConfigError(
                f"{type(record).__name__}: {field} is {value}; must be from {low:g} to {high:g}"
            )
