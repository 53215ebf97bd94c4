from __future__ import annotations

import json

import numpy as np
import pyarrow as pa
import pytest

from rendezvous.geometry.se2 import SE2
from rendezvous.schema import CUBOID_CORNER_SIGNS, EXPLORE, IMAGE_TYPE, PAIRS, VIEWS, Column, TableSchema
from tests.synthetic import synthetic_row


@pytest.fixture(scope="module")
def row():
    return synthetic_row(np.random.default_rng(3))


def _equal(a, b) -> bool:
    a, b = (v.as_array() if isinstance(v, SE2) else v for v in (a, b))
    return np.array_equal(a, b) if isinstance(a, np.ndarray) else a == b


def test_rows_survive_the_table_and_back(row):
    (again,) = EXPLORE.rows(EXPLORE.table([row]))
    assert all(_equal(again[name], value) for name, value in row.items())
    assert {name for name, value in again.items() if value is None} == {
        c.name for c in EXPLORE.columns if c.nullable
    } - row.keys()


def test_nested_label_columns_survive_the_table_and_back(row):
    cuboid_px = np.arange(18.0).reshape(9, 2)
    labels = {
        "projected_cuboid_px": cuboid_px,
        "box_px": np.arange(4.0),
        "image": b"jpeg",
        "T_c_o": np.eye(4),
    }
    cuboid_px[3] = np.nan
    sighting = {name: value for name, value in row.items() if name != "furniture"}
    (again,) = PAIRS.rows(PAIRS.table([sighting | labels]))
    assert np.array_equal(again["projected_cuboid_px"], cuboid_px, equal_nan=True)
    assert again["image"] == b"jpeg"
    assert np.array_equal(again["T_c_o"], np.eye(4))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"overlapp": 0.1}, r"explore row 0: no columns \['overlapp'\]"),
        ({"overlap": None}, "row 0, column overlap: missing"),
        ({"overlap": float("nan")}, "row 0, column overlap: nan is not finite"),
        ({"T_m0_r0": np.zeros(4)}, r"row 0, column T_m0_r0: shape \(4,\); must be \(3,\)"),
        ({"K": np.zeros(9)}, r"row 0, column K: shape \(9,\); must be \(3, 3\)"),
        ({"trajectory_0": np.zeros((5, 3))}, r"row 0, column trajectory_0: shape \(5, 3\); must be \(5, 4\)"),
        ({"map_0": "map.png"}, "row 0, column map_0: str; must be the bytes"),
    ],
)
def test_a_wrong_value_is_named_with_row_and_column(row, change, message):
    with pytest.raises(ValueError, match=message):
        EXPLORE.table([row | change])


def test_a_wrong_scalar_type_is_refused(row):
    with pytest.raises(pa.ArrowInvalid):
        EXPLORE.table([row | {"observer": "zero"}])


def test_no_rows_make_an_empty_table_of_the_same_schema():
    assert EXPLORE.table([]).schema.equals(EXPLORE.arrow())
    assert EXPLORE.table([]).num_rows == 0


def test_every_image_column_is_announced_to_hugging_face():
    features = json.loads(PAIRS.arrow().metadata[b"huggingface"])["info"]["features"]
    assert features == {name: {"_type": "Image"} for name in ("map_0", "map_1", "image")}
    assert {c.name for c in PAIRS.columns if c.type == IMAGE_TYPE} == features.keys()


def test_column_names_are_unique_and_described():
    names = [c.name for c in EXPLORE.columns]
    assert len(set(names)) == len(names)
    assert all(c.about.endswith(".") for c in EXPLORE.columns)


def test_explore_and_render_hold_all_that_is_published():
    made = {c.name: c.type for c in (*EXPLORE.columns, *VIEWS.columns)}
    assert {c.name: c.type for c in PAIRS.columns}.items() <= made.items()
    added = {c.name for c in VIEWS.columns} - {c.name for c in EXPLORE.columns}
    unknown = {"wall_agreement_local", "wall_agreement", "furniture_density"}
    assert {c.name for c in PAIRS.columns if c.nullable} - unknown == added


def test_a_column_named_for_a_unit_has_that_unit():
    for suffix in ("m", "s", "rad", "px"):
        named = [c for c in PAIRS.columns if c.name.endswith(f"_{suffix}")]
        assert named
        assert {c.unit for c in named} == {suffix}


def test_cuboid_corners_are_those_of_a_box_and_its_centre():
    signs = np.array(CUBOID_CORNER_SIGNS)
    assert len({tuple(s) for s in signs[:8].tolist()}) == 8
    assert np.all(np.abs(signs[:8]) == 1)
    assert np.array_equal(signs[8], np.zeros(3))
    # DOPE draws edges between these: each must differ along one axis only.
    edges = [(0, 1), (1, 2), (2, 3), (3, 0), (4, 5), (5, 6), (6, 7), (7, 4), (0, 4), (1, 5), (2, 6), (3, 7)]
    assert all(np.count_nonzero(signs[a] != signs[b]) == 1 for a, b in edges)


def test_a_small_table_can_be_described():
    schema = TableSchema(
        name="poses", columns=(Column(name="visibility", type=pa.float64(), about="Share."),)
    )
    assert schema.rows(schema.table([{"visibility": 0.5}])) == [{"visibility": 0.5}]
