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
class Conditions:
    """What all rows of one evaluation were measured on."""

    split: str  # of the dataset
    plans: int  # number of floor plans
    data_digest: str  # of the ids and content of what was measured
    seed: int  # of everything that was drawn
    commit: str  # of the code, or '' if unknown
    hardware: str  # of the machine

    @property
    def split_suffix(self) -> str:
        """The end of the name of a file with figures of this split."""
        return "" if self.split == "test" else f"-{self.split}"

    def facts(self, *counts: tuple[str, str]) -> list[tuple[str, str]]:
        """Names and values at the top of a part, with how much was measured among them."""
        return [("split", self.split), *counts, ("data", self.data_digest[:12]), ("seed", str(self.seed))]

    def made_from(
        self, digests: Mapping[str, str], dataset: str, versions: Mapping[str, str]
    ) -> list[tuple[str, str]]:
        """What a part was made from, by name: `digests` of its data and weights, `versions` of packages."""
        return [
            ("dataset", f"{dataset}, split {self.split}"),
            *digests.items(),
            ("commit", self.commit or "not known"),
            ("hardware", self.hardware),
            *versions.items(),
        ]


@dataclass(frozen=True, slots=True, kw_only=True)
class ImageConditions(Conditions):
    """The images on which all variants of one evaluation were measured."""

    images: int  # number of them
    weights: dict[str, str]  # SHA-256 of the weights' files, by what they are of
    # How many of the measured floor plans the weights were trained on, by what they are of; None if unknown.
    trained_on: dict[str, int | None]

    def file_name(self, name: str) -> str:
        """The file that records the latest figures of a variant on this split."""
        return f"{name}{self.split_suffix}.json"

    @property
    def measured_on(self) -> tuple[int, str]:
        """The number of images, and the noun."""
        return self.images, "images"

    def origin(self, dataset: str, versions: Mapping[str, str]) -> list[tuple[str, str]]:
        """`made_from` the images and weights."""
        weights = {f"weights, {name}": digest for name, digest in self.weights.items()}
        return self.made_from({"digest of the images": self.data_digest, **weights}, dataset, versions)


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
