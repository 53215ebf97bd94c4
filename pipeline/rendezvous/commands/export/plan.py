"""Write plans as files for other programs: HouseExpo JSON, GLB, MJCF."""

from __future__ import annotations

import difflib
from collections.abc import Mapping
from pathlib import Path

from rendezvous.commands.export.image_folder import write_file
from rendezvous.errors import FloorplanError
from rendezvous.floorplan.generate import shipped_floorplans
from rendezvous.floorplan.houseexpo import houseexpo_json
from rendezvous.plan_schema import PLAN_COLUMNS, plan_of
from rendezvous.robot_file import load_robot
from rendezvous.store.read import StageReader

_EXPORTED = ("glb", "glb_furnished", "mjcf")


def export_plan(meshes: StageReader, plan_id: str, out: Path) -> list[Path]:
    """Write one plan's JSON, its GLB with and without furniture, and its MJCF; returns the files.

    Raises:
        FloorplanError: there is no such plan.
        StoreError: `meshes` has not finished, or a file cannot be written.
    """
    items = {item.item_id: item for item in meshes.items()}
    if plan_id not in items:
        near = difflib.get_close_matches(plan_id, items, n=3) or list(items)[:3]
        raise FloorplanError(f"{meshes.root}: no plan {plan_id!r}; there are {', '.join(near)}, ...")
    (row,) = meshes.rows([items[plan_id]], columns=[*PLAN_COLUMNS, *_EXPORTED])
    return _written(
        out,
        {
            f"{plan_id}.json": houseexpo_json(plan_of(row)).encode(),
            f"{plan_id}.glb": row["glb"],
            f"{plan_id}-furnished.glb": row["glb_furnished"],
            f"{plan_id}.xml": row["mjcf"].encode(),
        },
    )


def export_floorplans(count: int, out: Path) -> list[Path]:
    """Write the shipped plans, or more: the first ones are the same for every count; returns the files."""
    plans = shipped_floorplans(count, robot_radius_m=load_robot("burger").radius_m)
    return _written(out, {f"{plan.plan_id}.json": houseexpo_json(plan).encode() for plan in plans})


def _written(out: Path, files: Mapping[str, bytes]) -> list[Path]:
    for name, content in files.items():
        write_file(out / name, content)
    return [out / name for name in files]
