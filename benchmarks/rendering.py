"""Labelled images: training images by two workers, pictures of sightings, shares of time, stock pyrender."""

from __future__ import annotations

import argparse
import multiprocessing
import statistics
import sys
import tempfile
import time
from collections.abc import Callable, Iterable
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from itertools import islice
from typing import Any

from benchmarks import stock_pyrender
from benchmarks.clocks import Clocks
from benchmarks.memory import mib_each_tenth
from benchmarks.scene import default_config, run_stage, shipped_plans
from rendezvous.errors import FloorplanError
from rendezvous.rendering.opengl.gl import renderer_name
from rendezvous.rendering.opengl.renderer import Renderer
from rendezvous.rendering.scene import Scene
from rendezvous.seeds import stream
from rendezvous.stages.dataset import pictures
from rendezvous.stages.dataset.photos import photo_folder
from rendezvous.store.read import StageReader

_WARM_UP = 8
_PARTS = (
    (pictures, "furnish", "furnishing"),
    (pictures, "furnished_plan", "furnishing"),
    (pictures, "_drawn_pose", "drawing at random"),
    (Renderer, "render", "image and ids"),
    (Renderer, "robot_view", "visibility"),
    (sys.modules["rendezvous.rendering.studio"], "apply_effects", "camera effects"),
    (pictures, "_encoded", "encoding"),
)


def measure(options: argparse.Namespace) -> dict[str, Any]:
    """Images per second at the Burger camera's 640x480, with labels, effects and encoding."""
    setting = default_setting()
    take(setting, 0, _WARM_UP)
    one = take(setting, _WARM_UP, options.images)
    with Clocks(_PARTS) as clocks:
        started_s = time.perf_counter()
        take(setting, _WARM_UP, options.images)
        shares = clocks.shares(time.perf_counter() - started_s)
    two = _in_processes(_rate, [(1000 * i, options.images) for i in range(2)])
    (beside_stock,) = _in_processes(_beside_stock_pyrender, [(24,)])
    (memory,) = _in_processes(_memory, [(options.memory_images,)])
    return {
        "renderer": renderer_name(),
        "shadow_share": setting.section.draws.shadow_share,
        "poses_one_worker": one,
        "poses_two_workers_images_per_s": round(sum(two), 1),
        "share_of_time": shares,
        "sightings": _sightings(),
        "image_and_ids_beside_stock_pyrender": beside_stock,
        "memory": memory,
    }


def default_setting() -> pictures.Setting:
    """The setting of the default preset."""
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


def _in_processes(function: Callable[..., Any], calls: list[tuple[int, ...]]) -> list[Any]:
    """Results of calls made at once, each in a new process."""
    spawn = multiprocessing.get_context("spawn")
    barrier = spawn.Barrier(len(calls))
    with ProcessPoolExecutor(len(calls), spawn, _wait_for, (barrier,)) as workers:
        return [done.result() for done in [workers.submit(function, *call) for call in calls]]


def _wait_for(barrier: Any) -> None:
    """Warm up, then wait until all workers are ready."""
    take(default_setting(), 0, _WARM_UP)
    barrier.wait()


def _rate(first: int, count: int) -> float:
    return float(take(default_setting(), first + _WARM_UP, count)["images_per_s"])


def _memory(images: int) -> dict[str, Any]:
    return mib_each_tenth(partial(take, default_setting()), images)


def _beside_stock_pyrender(count: int) -> dict[str, float]:
    setting = default_setting()
    scenes = list(_scenes(setting, count))
    ours_s = []
    for scene in scenes:
        started_s = time.perf_counter()
        setting.studio()._renderer.render(scene)
        ours_s.append(time.perf_counter() - started_s)
    ours = statistics.median(ours_s[count // 3 :])
    stock = stock_pyrender.seconds_per_image(setting, scenes)
    times = {"ours_ms": round(1e3 * ours, 1), "stock_ms": round(1e3 * stock, 1)}
    return {**times, "times_faster": round(stock / ours, 2)}


def _scenes(setting: pictures.Setting, count: int) -> Iterable[Scene]:
    """Plausible scenes, one for each of the shipped plans in turn."""
    plans, height_m = shipped_plans(), default_config().meshes.wall_height_m
    for number in range(count):
        _, place = next(iter(pictures._furnished(setting, plans[number % len(plans)], height_m)))
        yield pictures._drawn_pose(setting, place, "plausible", stream(0, "bench", number)).scene


def _sightings() -> dict[str, Any]:
    """Pictures of the sightings that `explore` has on three of the shipped plans."""
    files = ", ".join(f"floorplans/rdv-{number:03d}.json" for number in (0, 2, 8))
    few = ["--set", f"floorplans.sources=[{files}]", "--set", "floorplans.generate.count=0"]
    with tempfile.TemporaryDirectory() as data:
        for stage in ("floorplans", "meshes", "explore"):
            run_stage(stage, "--data", data, *few)
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
