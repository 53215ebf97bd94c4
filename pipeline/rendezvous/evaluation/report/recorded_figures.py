"""Figures of what works on images, with what they were measured on: kept, and shown again."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any, Generic, TypeVar

from pydantic import TypeAdapter, ValidationError

from rendezvous.errors import StoreError
from rendezvous.evaluation.frame_error.summary import without_nan

_FORMAT = 1

Figures = TypeVar("Figures")


@dataclass(frozen=True, slots=True, kw_only=True)
class ImageConditions:
    """What all variants of one evaluation were measured on.

    Attributes:
        split: of the dataset.
        images, plans: how many.
        data_digest: of the images' ids and content.
        seed: of the draw of images.
        weights: digests of the files of weights, by what they are of.
        trained_on: how many of the measured floor plans the weights were trained on, by what they are of;
            None where they do not tell.
        commit: of the code; empty if that is not known.
        hardware: where.
    """

    split: str
    images: int
    plans: int
    data_digest: str
    seed: int
    weights: dict[str, str]
    trained_on: dict[str, int | None]
    commit: str
    hardware: str


@dataclass(frozen=True, slots=True, kw_only=True)
class RecordedFigures(Generic[Figures]):
    """One variant's figures.

    Attributes:
        name: of the variant.
        conditions: what it was measured on.
        figures: a record of numbers, texts and records of them.
    """

    name: str
    conditions: ImageConditions
    figures: Figures

    @property
    def file_name(self) -> str:
        """Under which it is kept: the latest of each split."""
        split = "" if self.conditions.split == "test" else f"-{self.conditions.split}"
        return f"{self.name}{split}.json"

    def to_json(self) -> dict[str, Any]:
        """Values as JSON holds them."""
        figures: Any = self.figures
        return {
            "format": _FORMAT,
            "name": self.name,
            "conditions": asdict(self.conditions),
            "figures": without_nan(asdict(figures)),
        }


def recorded_from_json(
    values: Mapping[str, Any], kind: type[Figures], *, where: str, command: str
) -> RecordedFigures[Figures]:
    """Inverse of `RecordedFigures.to_json`.

    Args:
        values: as JSON holds them.
        kind: of figures.
        where, command: for messages: the file, and what writes it anew.

    Raises:
        StoreError: these are not such figures.
    """
    remedy = f"delete it, and `rendezvous {command} --record` makes it anew"
    try:
        if values["format"] != _FORMAT:
            raise StoreError(f"{where}: figures of format {values['format']}; must be {_FORMAT}; {remedy}")
        return RecordedFigures(
            name=str(values["name"]),
            conditions=TypeAdapter(ImageConditions).validate_python(values["conditions"]),
            figures=TypeAdapter(kind).validate_python(values["figures"]),
        )
    except (KeyError, TypeError) as error:
        raise StoreError(f"{where}: no recorded figures ({error}); {remedy}") from error
    except ValidationError as error:
        told = error.errors()[0]
        place = ".".join(str(key) for key in told["loc"])
        raise StoreError(f"{where}: no recorded figures ({place}: {told['msg']}); {remedy}") from error
