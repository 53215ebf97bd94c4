"""The default preset and the shipped plans, on which all is measured."""

from __future__ import annotations

import json
import subprocess
import sys
from functools import cache
from pathlib import Path

from rendezvous.config.load import Config, load_config
from rendezvous.floorplan.houseexpo import parse_floorplan
from rendezvous.floorplan.records import Floorplan, Solid
from rendezvous.floorplan.validate import validated
from rendezvous.floorplan.walls import wall_boxes
from rendezvous.robot_file import load_robot

ROOT = Path(__file__).parents[1]


@cache
def default_config() -> Config:
    return load_config(ROOT / "stages.yaml", preset="default")


@cache
def shipped_plans() -> tuple[Floorplan, ...]:
    files = sorted((ROOT / "floorplans").glob("*.json"))
    radius_m = load_robot(default_config().floorplans.robot).radius_m
    plans = [parse_floorplan(json.loads(f.read_text()), source=f.name) for f in files]
    return tuple(validated(plan, robot_radius_m=radius_m) for plan in plans)


@cache
def walls_of(plan_id: str) -> tuple[Solid, ...]:
    plan = next(plan for plan in shipped_plans() if plan.plan_id == plan_id)
    return wall_boxes(plan, height_m=default_config().meshes.wall_height_m)


def run_stage(stage: str, *options: str) -> None:
    """Run a stage by its command."""
    command = [sys.executable, "-m", "rendezvous.cli", stage, *options]
    subprocess.run(command, cwd=ROOT, check=True, stderr=subprocess.DEVNULL)
