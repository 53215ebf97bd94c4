"""Plans with known answers, and generated ones."""

from __future__ import annotations

import json
from functools import cache
from pathlib import Path

import numpy as np

from rendezvous.floorplan.generate import generate_floorplan
from rendezvous.floorplan.houseexpo import parse_floorplan
from rendezvous.floorplan.records import Floorplan
from rendezvous.robot_file import load_robot
from rendezvous.seeds import stream

RADIUS_M = load_robot("burger").radius_m

TWO_ROOMS = [
    [0.0, 0.0], [3.95, 0.0], [3.95, 1.5], [4.05, 1.5], [4.05, 0.0], [8.0, 0.0],
    [8.0, 4.0], [4.05, 4.0], [4.05, 2.4], [3.95, 2.4], [3.95, 4.0], [0.0, 4.0],
]  # fmt: skip
"""Two rooms of 3.95 m x 4 m, a wall of 0.1 m between them, a door of 0.9 m in it at (4, 1.95)."""


def plan_of(
    outline: list[list[float]], *, holes: tuple[list[list[float]], ...] = (), plan_id: str = "p"
) -> Floorplan:
    """A plan of these rings."""
    return Floorplan(
        plan_id=plan_id,
        outline_m=np.array(outline, dtype=np.float64),
        holes_m=tuple(np.array(hole, dtype=np.float64) for hole in holes),
    )


def genuine(real_data: Path) -> list[Floorplan]:
    """HouseExpo's plans, as they are read; there are some."""
    files = sorted((real_data / "houseexpo").glob("*.json"))
    assert files
    return [parse_floorplan(json.loads(file.read_text()), source=file.name) for file in files]


@cache
def generated(index: int) -> Floorplan:
    """The same plan for the same index, in every test."""
    return generate_floorplan(stream(0, "tests", index), plan_id=f"gen-{index}", robot_radius_m=RADIUS_M)
