"""The tables of floor plans: what `floorplans` and `meshes` write, and the way from records to rows and back."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any

import numpy as np
import pyarrow as pa

from rendezvous.floorplan.records import Floorplan, Room, Shape, Solid
from rendezvous.schema import SOLIDS_TYPE, Column, TableSchema

RING_TYPE = pa.list_(pa.list_(pa.float64(), 2))
ROOMS_TYPE = pa.list_(pa.struct([("category", pa.string()), ("box_m", pa.list_(pa.float64(), 4))]))

# One column a line, however long, so that the block reads as a table.
# ruff: noqa: E501
_PLAN = (
    Column(name="plan_id", type=pa.string(), about="Name of the floor plan."),
    Column(name="plan_digest", type=pa.string(), about="SHA-256 of the plan's geometry; splits go by it."),
    Column(name="outline_m", type=RING_TYPE, unit="m", about="Outer ring of the free space in w, counter-clockwise, not closed."),
    Column(name="holes_m", type=pa.list_(RING_TYPE), unit="m", about="Islands of wall inside it, clockwise, not closed."),
    Column(name="rooms", type=ROOMS_TYPE, unit="m", about="Labels: category and axis-aligned box x0, y0, x1, y1."),
)  # fmt: skip

FLOORPLANS = TableSchema(
    name="floorplans",
    columns=(
        *_PLAN,
        Column(name="origin", type=pa.string(), about="`houseexpo` if it was read, `generated` if it was made here."),
        Column(name="source", type=pa.string(), about="The file it was read from; a generated plan's own id."),
        Column(name="area_m2", type=pa.float64(), unit="m²", about="Area of the free space."),
        Column(name="start_regions", type=pa.int32(), about="Rooms in which a robot may start."),
    ),
)  # fmt: skip

MESHES = TableSchema(
    name="meshes",
    columns=(
        *_PLAN,
        Column(name="wall_height_m", type=pa.float64(), unit="m", about="Height of the walls."),
        Column(name="walls", type=SOLIDS_TYPE, unit="m, rad", about="One box per wall face, for physics and rays."),
        Column(name="furniture", type=SOLIDS_TYPE, unit="m, rad", about="Example furniture; each episode draws its own."),
        Column(name="glb", type=pa.binary(), about="Floor and walls as watertight meshes in a binary glTF file."),
        Column(name="glb_furnished", type=pa.binary(), about="The same with the example furniture."),
        Column(name="mjcf", type=pa.string(), about="The furnished plan with two robots in it; opens in MuJoCo's viewer as it is."),
    ),
)  # fmt: skip


def plan_row(plan: Floorplan) -> dict[str, Any]:
    """A plan as columns; inverse of `plan_of`."""
    return {
        "plan_id": plan.plan_id,
        "plan_digest": plan.digest(),
        "outline_m": plan.outline_m.tolist(),
        "holes_m": [hole_m.tolist() for hole_m in plan.holes_m],
        "rooms": [{"category": room.category, "box_m": list(room.box_m)} for room in plan.rooms],
    }


def plan_of(row: Mapping[str, Any]) -> Floorplan:
    """The plan in a row."""
    return Floorplan(
        plan_id=row["plan_id"],
        outline_m=np.array(row["outline_m"]),
        holes_m=tuple(np.array(hole_m) for hole_m in row["holes_m"]),
        rooms=tuple(Room(category=r["category"], box_m=tuple(r["box_m"])) for r in row["rooms"]),
    )


PLAN_COLUMNS = tuple(column.name for column in _PLAN)  # the columns that `plan_of` reads


def solid_rows(solids: Sequence[Solid]) -> list[dict[str, Any]]:
    """Solids as rows of `SOLIDS_TYPE`; inverse of `solids_of`."""
    return [asdict(solid) | {"shape": str(solid.shape)} for solid in solids]


def solids_of(rows: Sequence[Mapping[str, Any]]) -> tuple[Solid, ...]:
    """The solids in rows of `SOLIDS_TYPE`."""
    return tuple(Solid(**{**row, "shape": Shape(row["shape"])}) for row in rows)
