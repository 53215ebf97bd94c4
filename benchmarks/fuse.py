"""`rendezvous fuse`: its start-up, and each part of a fusion on one core once all is loaded."""

from __future__ import annotations

import argparse
import math
import resource
import statistics
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import cv2
import numpy as np
import pyarrow.parquet as pq
import torch

from benchmarks.scene import ROOT
from benchmarks.training import synthetic_pairs
from rendezvous.commands.export.sighting import export_sighting
from rendezvous.commands.fuse.fuse import FuseRequest, _matcher, _refiner, fused
from rendezvous.commands.fuse.inputs import mounting, read_camera, read_map, read_photograph
from rendezvous.commands.fuse.outputs import write_fused
from rendezvous.errors import StoreError
from rendezvous.evaluation.pictures.canvas import encoded_png
from rendezvous.evaluation.pictures.fusion import fusion_picture
from rendezvous.fusion.fusion_input import FusionInput, SightedPose
from rendezvous.fusion.refinement import Refinement, Refiner
from rendezvous.fusion.system import fuse_maps
from rendezvous.geometry.se2 import SE2
from rendezvous.interop.ros_map import write_ros_map
from rendezvous.pose_estimation.pose_estimate import ImagePoseEstimator
from rendezvous.schema import PAIRS
from rendezvous.stages.weights.pose_source import PoseWeights

TARGET_S, TARGET_START_S = 1.0, 3.0
SIGHTINGS = 5
TRIES = 3
DATASET = ROOT / "data" / "dataset"
SIGMA = (0.10, 0.05, math.radians(8.0))
"""Standard deviations [m, m, rad] of the relative pose, about those of one estimated from an image."""

DEFAULT = ("read maps", "read image", "see", "refine auto", "merge", "check", "draw and write")
"""The parts of a fusion with default options."""

_IMPORTS = (
    "import rendezvous.cli.__main__, rendezvous.commands.fuse.fuse as fuse, rendezvous.commands.fuse.outputs"
)
_MATCHER = f"{_IMPORTS}; auto = fuse.Refinement.AUTO; fuse._refiner(auto, fuse._matcher(auto))"
_START = {
    "without a network": _IMPORTS,
    "with the matcher": _MATCHER,
    "with both networks": f"{_MATCHER}; fuse.PoseWeights.found(None).estimator(floor=True)",
}


@dataclass(frozen=True, slots=True, kw_only=True)
class _Sighting:
    """A folder with two maps and perhaps an image with its camera; and where the robots stood."""

    folder: Path
    T_m0_r0: SE2
    T_m1_r1: SE2
    T_r0_r1: SE2


@dataclass(slots=True)
class _Costs:
    """Seconds of processor and clock that each part took, by its name."""

    cpu: dict[str, list[float]] = field(default_factory=dict)
    wall: dict[str, list[float]] = field(default_factory=dict)

    @contextmanager
    def part(self, name: str) -> Iterator[None]:
        cpu_s, wall_s = time.process_time(), time.perf_counter()
        yield
        self.cpu.setdefault(name, []).append(time.process_time() - cpu_s)
        self.wall.setdefault(name, []).append(time.perf_counter() - wall_s)


def measure(options: argparse.Namespace) -> dict[str, Any]:
    """Medians over sightings. On a machine with other work, look at the time of the processor."""
    torch.set_num_threads(1)
    cv2.setNumThreads(1)
    estimator = _pose_estimator()
    refiners = {refine: _refiner(refine, _matcher(refine)) for refine in Refinement}
    costs = _Costs()
    with TemporaryDirectory() as name:
        sightings = list(_published(Path(name))) if DATASET.is_dir() else [_synthetic(Path(name))]
        _fuse(sightings[0], estimator, refiners, _Costs())  # compiles
        for sighting in sightings:
            _fuse(sighting, estimator, refiners, costs)
    total_s = sum(statistics.median(costs.cpu[part]) for part in DEFAULT if part in costs.cpu)
    return {
        "sightings": f"{len(sightings)} of {'data/dataset' if DATASET.is_dir() else 'a synthetic pair'}",
        "start_s": {name: _start_s(code) for name, code in _START.items()} | {"target": TARGET_START_S},
        "ms_of_processor": _medians_ms(costs.cpu),
        "ms_of_clock": _medians_ms(costs.wall),
        "fuse": {
            "parts": [part for part in DEFAULT if part in costs.cpu],
            "s_of_processor": round(total_s, 3),
            "target": TARGET_S,
        },
    }


def _fuse(
    sighting: _Sighting,
    estimator: ImagePoseEstimator | None,
    refiners: Mapping[Refinement, Refiner | None],
    costs: _Costs,
) -> None:
    maps = sighting.folder / "map0.yaml", sighting.folder / "map1.yaml"
    with costs.part("read maps"):
        grid_0, grid_1 = (read_map(path, strict=False) for path in maps)
    if estimator is not None:
        _see(sighting.folder, estimator, costs)
    meeting = FusionInput(grid_0=grid_0, grid_1=grid_1, T_m0_r0=sighting.T_m0_r0, T_m1_r1=sighting.T_m1_r1)
    sighted = SightedPose.given(sighting.T_r0_r1, np.diag(np.square(SIGMA)))
    for refine, refiner in refiners.items():
        refining = f"refine {refine}"
        result = fuse_maps(
            meeting,
            sighted,
            refiner,
            part=lambda name, refining=refining: costs.part(refining if name == "refine" else name),
        )
    with costs.part("draw"):
        encoded_png(fusion_picture(meeting, result))
    found = fused(_request(sighting, estimator))
    with costs.part("draw and write"):
        write_fused(found, sighting.folder / "out")


def _request(sighting: _Sighting, estimator: ImagePoseEstimator | None) -> FuseRequest:
    """The request to fuse a sighting; by its image, if there are one and an estimator."""
    folder = sighting.folder
    seen = estimator is not None and (folder / "image.png").is_file()
    return FuseRequest(
        maps=(folder / "map0.yaml", folder / "map1.yaml"),
        T_m0_r0=sighting.T_m0_r0,
        T_m1_r1=sighting.T_m1_r1,
        images=(folder / "image.png",) if seen else (),
        camera=folder / "camera.yaml" if seen else None,
        T_r0_r1=None if seen else sighting.T_r0_r1,
        refine=Refinement.NONE,
        pose_estimator=estimator if seen else None,
    )


def _see(folder: Path, estimator: ImagePoseEstimator, costs: _Costs) -> None:
    """Read and estimate the relative pose as `fuse` does, if there is an image."""
    if not (folder / "image.png").is_file():
        return
    with costs.part("read image"):
        camera = read_camera(folder / "camera.yaml")
        shot = read_photograph(folder / "image.png", camera, number=0)
    T_r0_c = mounting(None, "burger")
    with costs.part("see"):
        estimator(shot.image, camera.camera, T_r0_c)


def _pose_estimator() -> ImagePoseEstimator | None:
    """The trained estimator, if there are weights."""
    try:
        return PoseWeights.found(None).estimator(floor=True)
    except StoreError:
        return None


def _published(folder: Path) -> Iterator[_Sighting]:
    """The first sightings of the test split, as files."""
    path = min((DATASET / "pairs").glob("test-*.parquet"))
    columns = ["pair_id", "T_m0_r0", "T_m1_r1", "T_r0_r1_true"]
    for row in PAIRS.rows(pq.read_table(path, columns=columns).slice(0, SIGHTINGS)):
        out = folder / row["pair_id"]
        export_sighting(str(DATASET), row["pair_id"], out)
        yield _Sighting(
            folder=out, T_m0_r0=row["T_m0_r0"], T_m1_r1=row["T_m1_r1"], T_r0_r1=row["T_r0_r1_true"]
        )


def _synthetic(folder: Path) -> _Sighting:
    """Two maps of one room."""
    pair = synthetic_pairs()[0]
    assert pair.T_m0_r0 is not None
    for i, grid in enumerate((pair.grid_0, pair.grid_1)):
        write_ros_map(grid, folder / f"map{i}.yaml")
    return _Sighting(
        folder=folder,
        T_m0_r0=pair.T_m0_r0,
        T_m1_r1=pair.T_m1_r1,
        T_r0_r1=pair.T_m0_r0.inverse() @ pair.T_m0_r1,
    )


def _start_s(code: str) -> dict[str, float]:
    """Median seconds of several runs after one that fills the caches."""
    cpu_s, wall_s = [], []
    for _ in range(1 + TRIES):
        before, started_s = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
        subprocess.run([sys.executable, "-c", code], cwd=ROOT, check=True)
        wall_s.append(time.perf_counter() - started_s)
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        cpu_s.append(after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime)
    return {
        "of_processor": round(statistics.median(cpu_s[1:]), 2),
        "of_clock": round(statistics.median(wall_s[1:]), 2),
    }


def _medians_ms(seconds: Mapping[str, list[float]]) -> dict[str, float]:
    return {part: round(1e3 * statistics.median(times_s), 1) for part, times_s in seconds.items()}
