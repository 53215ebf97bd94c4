"""HouseExpo's JSON format (Li et al., "HouseExpo: A Large-scale 2D Indoor Layout Dataset", IROS 2020).

A plan is one object: `id`, `verts` (the free space's outer ring [m], not closed), `room_category` (category
to boxes x0, y0, x1, y1 [m]), `room_num` and `bbox`. Walls inside a building are notches in the one ring.
Where an island of wall stands free of the shell (a pillar), this package adds the key `holes`, a list of
rings; HouseExpo's own plans have none, and readers that do not know the key lose the islands only.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Mapping
from typing import Any

import numpy as np

from rendezvous.errors import FloorplanError
from rendezvous.floorplan.records import Floorplan, Room
from rendezvous.geometry.se2 import Array

PLAN_ID_PATTERN = re.compile(r"[A-Za-z0-9_][A-Za-z0-9._-]{0,127}")
"""A plan id names files and rows, so it has no slash, no space and no leading dot."""


def parse_floorplan(data: Mapping[str, Any], *, source: str) -> Floorplan:
    """The plan as it is written; `validated` repairs and judges its geometry.

    Raises:
        FloorplanError: the content is not what the format says; one line with source, plan id and reason.
    """
    if not isinstance(data, Mapping):
        raise FloorplanError(f"{source}: found {_shown(data)}; a floor plan is one JSON object")
    plan_id = _plan_id(data, source)
    where = f"{source}: plan {plan_id}"
    holes = data.get("holes", [])
    if not isinstance(holes, list | tuple):
        raise FloorplanError(f"{where}: holes is {_shown(holes)}; must be a list of rings")
    return Floorplan(
        plan_id=plan_id,
        outline_m=_ring(_required(data, "verts", where), f"{where}: verts"),
        holes_m=tuple(_ring(hole, f"{where}: holes[{i}]") for i, hole in enumerate(holes)),
        rooms=_rooms(data.get("room_category", {}), where),
    )


def to_houseexpo(floorplan: Floorplan) -> dict[str, Any]:
    """The JSON object of a plan, coordinates rounded to the millimetre; inverse of `parse_floorplan`."""
    boxes: dict[str, list[list[float]]] = {}
    for room in floorplan.rooms:
        boxes.setdefault(room.category, []).append([round(v, 3) for v in room.box_m])
    low_m, high_m = floorplan.outline_m.min(axis=0), floorplan.outline_m.max(axis=0)
    data = {
        "verts": _rounded(floorplan.outline_m),
        "id": floorplan.plan_id,
        "room_category": boxes,
        "room_num": len(floorplan.rooms),
        "bbox": {"min": np.round(low_m, 3).tolist(), "max": np.round(high_m, 3).tolist()},
    }
    if floorplan.holes_m:
        data["holes"] = [_rounded(hole_m) for hole_m in floorplan.holes_m]
    return data


def houseexpo_json(floorplan: Floorplan) -> str:
    """The plan's file: `to_houseexpo` as compact JSON in one line; equal plans give equal text."""
    return json.dumps(to_houseexpo(floorplan), separators=(",", ":")) + "\n"


def _rounded(ring_m: Array) -> list[list[float]]:
    return np.round(ring_m, 3).tolist()


def _plan_id(data: Mapping[str, Any], source: str) -> str:
    plan_id = _required(data, "id", source)
    if not isinstance(plan_id, str) or not PLAN_ID_PATTERN.fullmatch(plan_id):
        raise FloorplanError(
            f"{source}: id is {_shown(plan_id)}; must be a string of letters, digits, '.', '_' and '-'"
        )
    return plan_id


def _required(data: Mapping[str, Any], key: str, where: str) -> Any:
    if key not in data:
        found = ", ".join(str(k) for k in list(data)[:8]) or "nothing"
        raise FloorplanError(f"{where}: key '{key}' is missing (found {_shown_text(found)}); must be present")
    return data[key]


def _ring(vertices: Any, where: str) -> Array:
    """(N, 2) [m], without the closing vertex that some writers repeat."""
    if not isinstance(vertices, list | tuple):
        raise FloorplanError(f"{where} is {_shown(vertices)}; must be a list of [x, y] in metres")
    ring_m = [_numbers(vertex, 2, f"{where}[{i}]", "[x, y] in metres") for i, vertex in enumerate(vertices)]
    if len(ring_m) > 1 and ring_m[0] == ring_m[-1]:
        ring_m.pop()
    if len(ring_m) < 3:
        raise FloorplanError(f"{where} has {len(ring_m)} vertices; a ring needs at least 3")
    return np.array(ring_m, dtype=np.float64)


def _rooms(categories: Any, where: str) -> tuple[Room, ...]:
    if not isinstance(categories, Mapping):
        raise FloorplanError(
            f"{where}: room_category is {_shown(categories)}; must be an object of category: boxes"
        )
    return tuple(
        Room(category=str(category), box_m=box_m)
        for category, boxes in categories.items()
        for box_m in _boxes(boxes, f"{where}: room_category[{_shown(category)}]")
    )


def _boxes(boxes: Any, where: str) -> list[tuple[float, float, float, float]]:
    """Boxes with their corners in order; a box without area says nothing about where the room is."""
    if not isinstance(boxes, list | tuple):
        raise FloorplanError(f"{where} is {_shown(boxes)}; must be a list of [x0, y0, x1, y1] in metres")
    # HouseExpo's README describes a single flat box per category, its files hold lists of boxes.
    listed = [boxes] if boxes and not isinstance(boxes[0], list | tuple) else boxes
    ordered = []
    for i, box in enumerate(listed):
        xa, ya, xb, yb = _numbers(box, 4, f"{where}[{i}]", "[x0, y0, x1, y1] in metres")
        ordered.append((min(xa, xb), min(ya, yb), max(xa, xb), max(ya, yb)))
    return [box for box in ordered if box[2] > box[0] and box[3] > box[1]]


def _numbers(values: Any, count: int, where: str, right: str) -> tuple[float, ...]:
    if not isinstance(values, list | tuple) or len(values) != count or not all(map(_is_finite, values)):
        raise FloorplanError(f"{where} is {_shown(values)}; must be {right}, finite numbers")
    return tuple(float(v) for v in values)


def _is_finite(value: Any) -> bool:
    # bool is an int to Python; 1e400 written out as an integer does not fit a float.
    if isinstance(value, bool) or not isinstance(value, int | float):
        return False
    return math.isfinite(value) if isinstance(value, float) else abs(value) < 10**300


def _shown(value: Any) -> str:
    return _shown_text(repr(value))


def _shown_text(text: str) -> str:
    """A value as it fits on the one line of a message."""
    line = " ".join(text.split())
    return line if len(line) <= 60 else f"{line[:57]}..."
