"""Golden values of the `smoke` preset at seed 0; `make golden` writes them anew.

Plans, furniture and starts follow from plain arithmetic and hold on every machine. A run of many thousand
physics steps and scan matches amplifies the last bit of a sine, which differs between processors and
library versions; a short probe of that arithmetic is kept beside the values. Where the probe gives the same
bits, everything must; where it does not, the values are compared within the tolerances of the test.
"""

from __future__ import annotations

import hashlib
import io
import json
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console

from pipeline.config import load_config
from pipeline.engine import Run
from pipeline.exploration.episode import run_episode
from pipeline.exploration.records import EpisodeParameters
from pipeline.exploration.surroundings import furnished
from pipeline.floorplan.records import Floorplan
from pipeline.floorplan.walls import wall_boxes
from pipeline.geometry.se2 import SE2
from pipeline.pool import Engine
from pipeline.robot_file import load_robot
from pipeline.seeds import stream
from pipeline.stages.explore import explore
from pipeline.stages.floorplans import floorplans
from pipeline.stages.meshes import meshes
from pipeline.stages.pack import pack
from pipeline.store.read import StageReader

GOLDEN = Path(__file__).with_name("golden.json")
STAGES_YAML = Path(__file__).parents[1] / "stages.yaml"
STAGES = {"floorplans": floorplans, "meshes": meshes, "explore": explore, "pack": pack}

_ROW = ("pair_id", "t_s", "T_w_m0", "T_w_m1", "T_m0_m1", "overlap", "slam_position_error_0_m")


def make(data: str) -> Run:
    """The smoke preset at seed 0, in this process."""
    run = Run(
        config=load_config(STAGES_YAML, preset="smoke", seed=0),
        data=data,
        workers=1,
        engine=Engine.INLINE,
        console=Console(file=io.StringIO()),
    )
    for stage in STAGES.values():
        stage(run)
    return run


def values(run: Run) -> dict[str, Any]:
    """What is compared."""
    readers = {stage: run.read(stage) for stage in STAGES}
    return {
        "probe": probe(),
        "plans": {row["plan_id"]: row["plan_digest"] for row in readers["floorplans"].rows()},
        "furniture": {
            row["plan_id"]: [
                [s["category"], round(s["x_m"], 6), round(s["y_m"], 6)] for s in row["furniture"]
            ]
            for row in readers["meshes"].rows(columns=["plan_id", "furniture"])
        },
        "pairs": list(readers["explore"].rows(columns=_ROW)),
        "counts": readers["explore"].manifest().counts(),
        "content": {stage: _content(reader) for stage, reader in readers.items()},
    }


def _content(reader: StageReader) -> dict[str, str]:
    return {shard.name: shard.content_digest for shard in reader.shards()}


def probe() -> str:
    """Hash of what 40 simulated seconds in a bare room leave: physics, lidar, SLAM and planning."""
    plan = Floorplan(plan_id="room", outline_m=np.array([[0.0, 0.0], [5.0, 0.0], [5.0, 4.0], [0.0, 4.0]]))
    robot = load_robot("burger")
    episode = run_episode(
        furnished(plan, wall_boxes(plan, height_m=2.5), (), robot),
        (robot, robot),
        (SE2(1.0, 1.0, 0.3), SE2(4.0, 3.0, 2.0)),
        EpisodeParameters(max_time_s=40.0, first_event_s=(5.0, 5.1)),
        rng=stream(0, "probe"),
    )
    h = hashlib.sha256()
    for event in episode.events:
        for snapshot in event.snapshots:
            h.update(snapshot.trajectory.tobytes() + snapshot.trajectory_w.tobytes())
            h.update(snapshot.grid.cells.tobytes())
    return h.hexdigest()


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as folder:
        GOLDEN.write_text(json.dumps(values(make(folder)), indent=1, sort_keys=True) + "\n")
    print(f"wrote {GOLDEN}")
