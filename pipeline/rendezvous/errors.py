"""Errors that the user can fix.

A `PipelineError` says where, what was found and what would be right. The command line prints it as one
line and exits with 2; anything else is a bug and keeps its traceback.
"""


class PipelineError(Exception):
    """Something the user can fix."""


class ConfigError(PipelineError):
    """A wrong key or value in `stages.yaml`, `--set` or a robot file."""


class FloorplanError(PipelineError):
    """A floor plan that cannot be used."""


class MapError(PipelineError):
    """An occupancy grid or map file that cannot be used."""


class SightingError(PipelineError):
    """Images or poses that do not tell where one robot saw the other."""


class CameraError(PipelineError):
    """A camera's description, or an image, that cannot be used."""


class StoreError(PipelineError):
    """A dataset folder that is missing, damaged or cannot be written."""


class SplitError(PipelineError):
    """Splits that cannot be made from the plans at hand."""


class SetupError(PipelineError):
    """A package or system library that is missing."""


def require_within(record: object, **bounds: tuple[float, float]) -> None:
    """Check fields of a record of settings against closed bounds.

    Raises:
        ConfigError: names the field, its value, and the bounds.
    """
    for field, (low, high) in bounds.items():
        value = getattr(record, field)
        if not low <= value <= high:
            raise ConfigError(
                f"{type(record).__name__}: {field} is {value}; must be from {low:g} to {high:g}"
            )
