"""Figures with what they were measured on: recorded as JSON, and shown again by later reports."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any, Generic, Protocol, TypeVar

from pydantic import TypeAdapter, ValidationError

from rendezvous.errors import StoreError
from rendezvous.evaluation.json_record import without_nan

FORMAT = 1
"""Version of the files of recorded rows."""

Figures = TypeVar("Figures")


class Recordable(Protocol):
    """A row that can be recorded."""

    @property
    def name(self) -> str:
        """The method's or variant's name."""

    @property
    def conditions(self) -> Any:
        """Conditions of the measurement: `split`, `measured_on` and `file_name(name)`."""

    def to_json(self) -> dict[str, Any]:
        """JSON values, with the format."""


Row = TypeVar("Row", bound=Recordable)


@dataclass(frozen=True, slots=True, kw_only=True)
class ImageConditions:
    """The images on which all variants of one evaluation were measured."""

    split: str  # of the dataset
    # images, plans: their numbers.
    images: int
    plans: int
    data_digest: str  # digest of the images' ids and content
    seed: int  # of the draw of images
    weights: dict[str, str]  # SHA-256 of the weights' files, by what they are of
    # How many of the measured floor plans the weights were trained on, by what they are of; None if unknown.
    trained_on: dict[str, int | None]
    commit: str  # of the code, or '' if unknown
    hardware: str  # of the machine

    def file_name(self, name: str) -> str:
        """The file that records the latest figures of a variant on this split."""
        return f"{name}{'' if self.split == 'test' else f'-{self.split}'}.json"

    @property
    def measured_on(self) -> tuple[int, str]:
        """The number of images, and the noun."""
        return self.images, "images"


@dataclass(frozen=True, slots=True, kw_only=True)
class RecordedFigures(Generic[Figures]):
    """One variant's figures."""

    name: str  # of the variant
    conditions: ImageConditions  # what it was measured on
    figures: Figures  # a record of numbers, texts and records of them

    def to_json(self) -> dict[str, Any]:
        """JSON values; NaN and infinity become null."""
        return {"format": FORMAT, **without_nan(asdict(self))}


def read_recorded(values: Mapping[str, Any], kind: type[Row], *, where: str, command: str) -> Row:
    """Inverse of a row's `to_json`.

    Args:
        values: JSON values.
        kind: of the row, such as `RecordedFigures[PoseSummary]`.
        where, command: for messages: the file, and the command that writes it.

    Raises:
        StoreError: `values` is not such a row.
    """
    remedy = f"delete it, and `rendezvous {command} --record` makes it anew"
    fields = dict(values)
    if (found := fields.pop("format", None)) != FORMAT:
        raise StoreError(f"{where}: recorded figures of format {found}; must be {FORMAT}; {remedy}")
    try:
        return TypeAdapter(kind).validate_python(fields)
    except ValidationError as error:
        first = error.errors()[0]
        place = ".".join(str(key) for key in first["loc"])
        raise StoreError(f"{where}: no recorded figures ({place}: {first['msg']}); {remedy}") from error
