"""Records become JSON's own types."""

from enum import StrEnum

import numpy as np
import pytest

from rendezvous.rendering.record import plain
from rendezvous.rendering.scene import Material


class _Kind(StrEnum):
    ONE = "one"


def test_records_arrays_and_enums_become_plain():
    value = {
        1: Material(base_colour_rgb=(0.1, 0.2, 0.3)),
        "T": np.eye(2),
        "kind": _Kind.ONE,
        "n": np.int64(3),
    }
    assert plain(value) == {
        "1": {
            "base_colour_rgb": [0.1, 0.2, 0.3],
            "metallic": 0.0,
            "roughness": 0.8,
            "texture": None,
            "texture_scale_m": 1.0,
        },
        "T": [[1.0, 0.0], [0.0, 1.0]],
        "kind": "one",
        "n": 3,
    }
    assert type(plain(_Kind.ONE)) is str


def test_what_json_has_no_form_for_is_refused():
    with pytest.raises(TypeError, match="complex has no JSON form"):
        plain([1j])
