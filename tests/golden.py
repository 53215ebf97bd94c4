"""Golden values of the `smoke` preset at seed 0; `make golden` writes them anew.

Plans, furniture and starts follow from plain arithmetic and hold on every machine. A run of many thousand
physics steps and scan matches amplifies the last bit of a sine, which differs between processors and
library versions; a probe of that arithmetic, made without our code, is kept beside the values. Where the
probe gives the same bits, everything must; where not, the tolerances of the test apply. Of images only the
labels are kept: what draws them differs from machine to machine, and golden.png sees to the pixels.
"""

from __future__ import annotations

import hashlib
import json
import math
import tempfile
from importlib.metadata import version
from pathlib import Path
from typing import Any

import mujoco
import numba as nb
import numpy as np

from rendezvous.config.stage_table import DATASET_STAGES
from rendezvous.engine.run import Run
from rendezvous.stages import stage_function
from rendezvous.store.read import StageReader
from tests.conftest import run_in

GOLDEN = Path(__file__).with_name("golden.json")

_ROW = ("pair_id", "t_s", "T_w_m0", "T_w_m1", "T_m0_m1", "overlap", "slam_position_error_0_m")


def make(data: str) -> Run:
    """The smoke preset at seed 0, in this process."""
    run = run_in(data, seed=0)
    for stage in DATASET_STAGES:
        stage_function(stage)(run)
    return run


def values(run: Run) -> dict[str, Any]:
    """What is compared."""
    readers = {stage: run.read(stage) for stage in DATASET_STAGES}
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
        "content": {stage: _content(readers[stage]) for stage in ("floorplans", "meshes", "explore")},
        "poses": _labels(readers["render"], "poses/", "pose_id"),
        "views": _labels(readers["render"], "views/", "pair_id"),
    }


def _content(reader: StageReader) -> dict[str, str]:
    return {shard.name: shard.content_digest for shard in reader.shards()}


def _labels(reader: StageReader, under: str, key: str) -> dict[str, Any]:
    """Where the robot is in each image, and how many of its pixels show and would show."""
    columns = [key, "T_c_o", "visible_px", "silhouette_px"]
    rows = [
        row for shard in reader.shards(under) for row in reader.table(shard.name, columns=columns).to_pylist()
    ]
    return {
        row[key]: [
            row["T_c_o"] and [row["T_c_o"][i] for i in (3, 7, 11)],
            row["visible_px"],
            row["silhouette_px"],
        ]
        for row in rows
    }


def probe() -> str:
    """Hash of arithmetic that is not ours: MuJoCo, numpy's and numba's functions, package versions.

    Where it is the same, a difference in the values is of our own making.
    """
    h = hashlib.sha256()
    for package in ("mujoco", "numpy", "numba", "shapely", "opencv-python-headless", "pyarrow"):
        h.update(f"{package} {version(package)} ".encode())
    model = mujoco.MjModel.from_xml_string(_BALLS)
    data = mujoco.MjData(model)
    mujoco.mj_step(model, data, nstep=2000)
    h.update(data.qpos.tobytes())
    x = np.linspace(-4.0, 4.0, 4001)
    for values in (np.sin(x), np.cos(x), np.arctan2(x, 1.0 + x), np.hypot(x, 1.3), np.exp(x)):
        h.update(values.tobytes())
    h.update(_compiled(x).tobytes())
    h.update(np.linalg.solve(np.vander(x[1:40:13]), x[1:40:13]).tobytes())
    return h.hexdigest()


_BALLS = """<mujoco><option timestep="0.005" integrator="implicitfast" cone="elliptic"/><worldbody>
<geom type="plane" size="5 5 1"/><geom type="box" size="0.2 0.2 0.2" pos="0.3 0.1 0.1" euler="0 0 30"/>
<body pos="0 0 1"><freejoint/><geom type="ellipsoid" size="0.1 0.2 0.1" mass="1"/></body>
<body pos="0.1 0.1 2"><freejoint/><geom type="cylinder" size="0.1 0.1" mass="1"/></body>
</worldbody></mujoco>"""


@nb.njit
def _compiled(x: np.ndarray) -> np.ndarray:
    out = np.empty_like(x)
    for i in range(x.shape[0]):
        out[i] = math.sin(x[i]) * math.atan2(x[i], 1.1) + math.hypot(x[i], math.cos(x[i]))
    return out


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as folder:
        GOLDEN.write_text(json.dumps(values(make(folder)), indent=1, sort_keys=True) + "\n")
    print(f"wrote {GOLDEN}")
