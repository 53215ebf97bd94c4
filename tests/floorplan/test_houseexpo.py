from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rendezvous.errors import FloorplanError
from rendezvous.floorplan.houseexpo import houseexpo_json, parse_floorplan, to_houseexpo
from rendezvous.floorplan.records import Floorplan, Room
from rendezvous.floorplan.validate import validated
from tests.floorplan.plans import RADIUS_M, TWO_ROOMS, generated

SQUARE = [[0, 0], [4, 0], [4, 4], [0, 4]]


def test_ring_is_read_as_it_is_written():
    plan = parse_floorplan({"id": "a", "verts": SQUARE}, source="a.json")
    assert plan.plan_id == "a"
    np.testing.assert_array_equal(plan.outline_m, np.array(SQUARE, dtype=float))
    assert plan.rooms == ()


def test_a_closing_vertex_is_dropped():
    plan = parse_floorplan({"id": "a", "verts": [*SQUARE, SQUARE[0]]}, source="a.json")
    assert len(plan.outline_m) == 4


def test_boxes_are_ordered_and_those_without_area_dropped():
    boxes = {"Kitchen": [[5.0, 3.0, -1.0, -0.5], [1.0, 1.0, 1.0, 2.0]], "Hall": [0, 0, 2, 2], "Gym": []}
    plan = parse_floorplan({"id": "a", "verts": SQUARE, "room_category": boxes}, source="a.json")
    assert plan.rooms == (
        Room(category="Kitchen", box_m=(-1.0, -0.5, 5.0, 3.0)),
        Room(category="Hall", box_m=(0.0, 0.0, 2.0, 2.0)),
    )


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"id": ...}, r"^f\.json: key 'id' is missing \(found verts\); must be present$"),
        ({"id": 7}, r"^f\.json: id is 7; must be a string of letters"),
        ({"id": "../../etc/passwd"}, r"id is '\.\./\.\./etc/passwd'; must be a string"),
        ({"id": "a\nb"}, r"id is 'a\\nb'; must be"),
        ({"verts": ...}, r"^f\.json: plan p: key 'verts' is missing \(found id\); must be present$"),
        ({"verts": None}, r"verts is None; must be a list of \[x, y\] in metres"),
        ({"verts": "abc"}, r"verts is 'abc'; must be a list"),
        ({"verts": {"0": [1, 2]}}, r"must be a list of \[x, y\]"),
        ({"verts": []}, r"verts has 0 vertices; a ring needs at least 3"),
        ({"verts": [[0, 0], [1, 1]]}, r"verts has 2 vertices"),
        ({"verts": [[0, 0], [1, 1], [0, 0]]}, r"verts has 2 vertices"),
        ({"verts": [[0, 0], [1, "1"], [1, 1]]}, r"verts\[1\] is \[1, '1'\]; must be \[x, y\] in metres"),
        ({"verts": [[0, 0], [1, math.nan], [1, 1]]}, r"verts\[1\] is \[1, nan\]; must be"),
        ({"verts": [[0, 0], [1, math.inf], [1, 1]]}, r"verts\[1\] is \[1, inf\]"),
        ({"verts": [[0, 0], [1, 10**400], [1, 1]]}, r"verts\[1\] is \[1, 1000"),
        ({"verts": [[0, 0], [True, 1], [1, 1]]}, r"verts\[1\] is \[True, 1\]"),
        ({"verts": [[0, 0], [1, 2, 3], [1, 1]]}, r"verts\[1\] is \[1, 2, 3\]"),
        ({"verts": [[0, 0], None, [1, 1]]}, r"verts\[1\] is None"),
        ({"room_category": []}, r"room_category is \[\]; must be an object of category: boxes"),
        ({"room_category": {"Hall": 3}}, r"room_category\['Hall'\] is 3; must be a list of \[x0,"),
        ({"room_category": {"Hall": [[0, 0, 1]]}}, r"room_category\['Hall'\]\[0\] is \[0, 0, 1\]"),
        ({"room_category": {"Hall": [[0, 0, 1, None]]}}, r"\[0\] is \[0, 0, 1, None\]"),
        ({"holes": 3}, r"holes is 3; must be a list of rings"),
        ({"holes": [[[0, 0], [1, 0]]]}, r"holes\[0\] has 2 vertices"),
    ],
)  # fmt: skip
def test_malformed_content_is_told_in_one_line(change: dict[str, Any], message: str):
    data = {"id": "p", "verts": SQUARE, **change}
    data = {key: value for key, value in data.items() if value is not ...}
    with pytest.raises(FloorplanError, match=message) as error:
        parse_floorplan(data, source="f.json")
    assert len(str(error.value).splitlines()) == 1


def test_what_is_no_object_is_told():
    with pytest.raises(FloorplanError, match=r"^f\.json: found \[\]; a floor plan is one JSON object$"):
        parse_floorplan([], source="f.json")  # type: ignore[arg-type]


JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=5) | st.dictionaries(st.text(max_size=5), inner, max_size=3),
    max_leaves=12,
)
VERTICES = st.lists(st.tuples(st.floats(), st.floats()).map(list), max_size=8)


@settings(max_examples=300, deadline=None)
@given(
    st.fixed_dictionaries(
        {},
        optional={"id": JSON | st.just("p"), "verts": JSON | VERTICES, "room_category": JSON, "holes": JSON},
    )
)
def test_any_json_gives_a_plan_or_one_line(data: dict[str, Any]):
    try:
        validated(parse_floorplan(data, source="f.json"), robot_radius_m=RADIUS_M)
    except FloorplanError as error:
        message = str(error)
    else:
        message = "none"
    assert len(message.splitlines()) == 1


@pytest.mark.parametrize("index", range(12))
def test_a_validated_plan_survives_its_file(index: int):
    plan = generated(index)
    read = parse_floorplan(json.loads(houseexpo_json(plan)), source="f.json")
    assert read.digest() == plan.digest() == validated(read, robot_radius_m=RADIUS_M).digest()
    assert sorted(map(repr, read.rooms)) == sorted(map(repr, plan.rooms))


def test_rooms_and_box_are_written():
    plan = Floorplan(
        plan_id="a",
        outline_m=np.array(TWO_ROOMS),
        rooms=(
            Room(category="Hall", box_m=(0.0, 0.0, 4.0, 4.0)),
            Room(category="Hall", box_m=(4.0, 0.0, 8.0, 4.0)),
        ),
    )
    data = to_houseexpo(plan)
    assert data["room_num"] == 2
    assert data["room_category"] == {"Hall": [[0.0, 0.0, 4.0, 4.0], [4.0, 0.0, 8.0, 4.0]]}
    assert data["bbox"] == {"min": [0.0, 0.0], "max": [8.0, 4.0]}
    assert "holes" not in data


def test_genuine_plans_are_read(real_data: Path):
    files = sorted((real_data / "houseexpo").glob("*.json"))
    assert files
    for file in files:
        data = json.loads(file.read_text())
        plan = parse_floorplan(data, source=file.name)
        assert plan.outline_m.tolist() == data["verts"]
        assert len(plan.rooms) == sum(map(len, data["room_category"].values()))
