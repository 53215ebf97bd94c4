"""Records that JSON can hold: poses as x [m], y [m], yaw [rad], arrays as lists, NaN and infinity as null."""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import cache
from typing import Annotated, Any, Self

import numpy as np
from pydantic import PlainSerializer, PlainValidator, TypeAdapter

from rendezvous.geometry.se2 import SE2, Array

Pose = Annotated[SE2, PlainValidator(SE2.from_array), PlainSerializer(lambda T: T.as_array().tolist())]
OptionalPose = Annotated[
    SE2 | None,
    PlainValidator(lambda xyyaw: None if xyyaw is None else SE2.from_array(xyyaw)),
    PlainSerializer(lambda T: None if T is None else T.as_array().tolist()),
]
OptionalArray = Annotated[
    Array | None,
    PlainValidator(lambda values: None if values is None else np.array(values)),
    PlainSerializer(lambda array: None if array is None else array.tolist()),
]
FiniteOrNot = Annotated[
    float,
    PlainValidator(lambda value: math.inf if value is None else float(value)),
    PlainSerializer(lambda value: value if math.isfinite(value) else None),
]
NanOrNumber = Annotated[
    float,
    PlainValidator(lambda value: math.nan if value is None else float(value)),
    PlainSerializer(lambda value: value if math.isfinite(value) else None),
]
Column = Annotated[
    Array,
    PlainValidator(lambda values: np.array(values, dtype=np.float64)),
    PlainSerializer(lambda array: array.tolist()),
]


def without_nan(value: Any) -> Any:
    """The same with None for numbers that JSON does not have."""
    if isinstance(value, dict):
        return {key: without_nan(v) for key, v in value.items()}
    if isinstance(value, list | tuple):
        return [without_nan(v) for v in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


class JsonRecord:
    """Base of dataclasses whose fields are of these types, or of types that pydantic knows."""

    __slots__ = ()

    def to_json(self) -> dict[str, Any]:
        """The fields as JSON holds them."""
        kind: Any = type(self)
        return _adapter(kind).dump_python(self, mode="json")

    @classmethod
    def from_json(cls, fields: Mapping[str, Any]) -> Self:
        """The inverse of `to_json`.

        Raises:
            ValueError, TypeError: these are not the record's fields.
        """
        kind: Any = cls
        return _adapter(kind).validate_python(dict(fields))


@cache
def _adapter(kind: Any) -> TypeAdapter[Any]:
    return TypeAdapter(kind)
