"""Labelled images: training images by two workers, pictures of sightings, shares of time, stock pyrender."""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
import time
from itertools import islice
from typing import Any

from rendezvous.errors import FloorplanError
from rendezvous.rendering.opengl.gl import renderer_name
from rendezvous.rendering.opengl.renderer import Renderer
from rendezvous.rendering.scene import Scene
from rendezvous.seeds import stream
from rendezvous.stages.dataset import pictures
from rendezvous.stages.dataset.photos import photo_folder
from rendezvous.store.read import StageReader

from benchmarks.clocks import Clocks
from benchmarks.scene import ROOT, default_config, shipped_plans

_WARM_UP = 8
_ONE_OF_TWO = """
import json, sys
from benchmarks import rendering
setting, images = rendering.default_setting(), int(sys.argv[2])
rendering.take(setting, int(sys.argv[1]), rendering._WARM_UP)
print("ready", flush=True)
sys.stdin.readline()
print(json.dumps(rendering.take(setting, int(sys.argv[1]) + rendering._WARM_UP, images)))
"""
_MANY = """
import json, resource, sys
import psutil
from benchmarks import rendering
setting, images, samples = rendering.default_setting(), int(sys.argv[1]), []
for tenth in range(10):
    rendering.take(setting, tenth * images // 10, images // 10)
    samples.append(round(psutil.Process().memory_info().rss / 2**20, 1))
peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**10
print(json.dumps({"images": images, "rss_mib_each_tenth": samples, "peak_rss_mib": round(peak, 1)}))
"""


_STOCK = """
import json, statistics, sys, time
from benchmarks import rendering, stock_pyrender
setting = rendering.default_setting()
scenes, ours_s = rendering.scenes(setting, int(sys.argv[1])), []
for scene in scenes:
    started_s = time.perf_counter()
    setting.studio()._renderer.render(scene)
    ours_s.append(time.perf_counter() - started_s)
ours = statistics.median(ours_s[len(scenes) // 3:])
stock = stock_pyrender.seconds_per_image(setting, scenes)
print(json.dumps({"ours_ms": round(1e3 * ours, 1), "stock_ms": round(1e3 * stock, 1),
                  "times_faster": round(stock / ours, 2)}))
"""


def measure(options: argparse.Namespace) -> dict[str, Any]:
    """Images per second at the Burger camera's 640x480, with labels, effects and encoding."""
    setting = default_setting()
    take(setting, 0, _WARM_UP)
    one = take(setting, _WARM_UP, options.images)
    with Clocks(_PARTS) as clocks:
        started_s = time.perf_counter()
        take(setting, _WARM_UP, options.images)
        shares = clocks.shares(time.perf_counter() - started_s)
    return {
        "renderer": renderer_name(),
        "shadow_share": setting.section.draws.shadow_share,
        "poses_one_worker": one,
        "poses_two_workers_images_per_s": _two_workers(options.images),
        "share_of_time": shares,
        "sightings": _sightings(),
        "image_and_ids_beside_stock_pyrender": _in_a_process(_STOCK, "24"),
        "memory": _in_a_process(_MANY, str(options.memory_images)),
    }


def default_setting() -> pictures.Setting:
    """That of the default preset."""
    config = default_config()
    section, robot = config.render, config.explore.robot
    return pictures.Setting(seed=config.seed, robot=robot, section=section, photos=photo_folder(None))


def take(setting: pictures.Setting, first: int, count: int) -> dict[str, Any]:
    """Training images of the shipped plans in turn, as many of each in a row as share a furnishing."""
    plans, height_m = shipped_plans(), default_config().meshes.wall_height_m
    row_of = setting.section.poses_per_furnishing
    taken, bytes_total, started_s = 0, 0, time.perf_counter()
    for number in range(first // row_of, (first + count) // row_of):
        plan = plans[number % len(plans)]
        for image, place in islice(pictures._furnished(setting, plan, height_m), row_of):
            try:
                row = pictures._pose_row(setting, place, f"{plan.plan_id}-{number}", row_of * number + image)
            except FloorplanError:  # no place for two robots among this furniture
                continue
            taken += 1
            bytes_total += len(row["image"])
    elapsed_s = time.perf_counter() - started_s
    return {
        "images": taken,
        "images_per_s": round(taken / elapsed_s, 2),
        "kb_per_image": round(bytes_total / taken / 1e3),
    }


def scenes(setting: pictures.Setting, count: int) -> list[Scene]:
    """Plausible scenes, one for each of the shipped plans in turn."""
    plans, height_m = shipped_plans(), default_config().meshes.wall_height_m
    found = []
    for number in range(count):
        plan = plans[number % len(plans)]
        _, place = next(iter(pictures._furnished(setting, plan, height_m)))
        found.append(pictures._drawn_pose(setting, place, "plausible", stream(0, "bench", number)).scene)
    return found


_PARTS = (
    (pictures, "furnish", "furnishing"),
    (pictures, "furnished_plan", "furnishing"),
    (pictures, "_drawn_pose", "drawing at random"),
    (Renderer, "render", "image and ids"),
    (Renderer, "robot_view", "visibility"),
    (sys.modules["rendezvous.rendering.studio"], "apply_effects", "camera effects"),
    (pictures, "_encoded", "encoding"),
)


def _two_workers(images: int) -> float:
    """Both at once, started together when both are warm."""
    command = [sys.executable, "-c", _ONE_OF_TWO]
    workers = [
        subprocess.Popen(
            [*command, str(1000 * i), str(images)],
            cwd=ROOT, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
        )
        for i in range(2)
    ]  # fmt: skip
    for worker in workers:
        assert worker.stdout is not None
        worker.stdout.readline()
    results = []
    for worker in workers:
        assert worker.stdin is not None
        worker.stdin.write("go\n")
        worker.stdin.flush()
    for worker in workers:
        out, _ = worker.communicate()
        results.append(json.loads(out))
    return round(sum(result["images_per_s"] for result in results), 1)


def _sightings() -> dict[str, Any]:
    """Pictures of the sightings that `explore` has on three of the shipped plans."""
    files = ", ".join(f"floorplans/rdv-{number:03d}.json" for number in (0, 2, 8))
    with tempfile.TemporaryDirectory() as data:
        for stage in ("floorplans", "meshes", "explore"):
            few = ["--set", f"floorplans.sources=[{files}]", "--set", "floorplans.generate.count=0"]
            _run([stage, "--data", data, *few])
        meshes, explore = StageReader(f"{data}/meshes"), StageReader(f"{data}/explore")
        items = list(explore.items())
        walls = {item.item_id: item for item in meshes.items()}
        started_s = time.perf_counter()
        shard = pictures.views(
            default_setting(), meshes, [walls[item.item_id] for item in items], explore, items
        )
        elapsed_s = time.perf_counter() - started_s
    images = shard.table.num_rows
    return {"images": images, "images_per_s_one_worker": round(images / elapsed_s, 2)}


def _run(arguments: list[str]) -> None:
    command = [sys.executable, "-m", "rendezvous.cli", *arguments]
    subprocess.run(command, cwd=ROOT, check=True, stderr=subprocess.DEVNULL)


def _in_a_process(code: str, *arguments: str) -> dict[str, Any]:
    command = [sys.executable, "-c", code, *arguments]
    done = subprocess.run(command, cwd=ROOT, check=True, stdout=subprocess.PIPE, text=True)
    return dict(json.loads(done.stdout))
