"""Whole episodes on one core: two robots, furniture, all noise, the default preset."""

from __future__ import annotations

import argparse
import statistics
import sys
import time
from dataclasses import replace
from typing import Any

from benchmarks.clocks import Clocks
from benchmarks.scene import default_config, shipped_plans, walls_of
from rendezvous.errors import FloorplanError
from rendezvous.exploration import episode as episode_room
from rendezvous.exploration.explorer import Explorer
from rendezvous.robot_file import load_robot
from rendezvous.simulation.drive import Physics
from rendezvous.simulation.world import Drive
from rendezvous.slam.slam import Slam
from rendezvous.stages import explore as stage
from rendezvous.stages.dataset.sightings import sighting_rows


def measure(options: argparse.Namespace) -> dict[str, Any]:
    """Real-time factor and yield without clocks, then the shares of time with them."""
    _run(0, 1, drive="wheels")  # compiles
    timed = {drive: _run(1, options.episodes, drive=drive) for drive in ("wheels", "planar")}
    with Clocks(_PARTS) as clocks:
        started_s = time.perf_counter()
        _run(1, max(4, options.episodes // 4), drive="wheels")
        shares = clocks.shares(time.perf_counter() - started_s)
    return {**timed, "share_of_time": shares}


def short_episodes(first: int, count: int, *, max_time_s: float = 15.0) -> None:
    """Run episodes that end early."""
    _run(first, count, drive="wheels", max_time_s=max_time_s, first_event_s=(3.0, 8.0))


def _run(first: int, count: int, *, drive: str, **changed: Any) -> dict[str, Any]:
    """Run episodes on the shipped plans in turn, with some of their parameters changed."""
    section = default_config().explore
    section = section.model_copy(update={"episode": replace(section.episode, drive=Drive(drive), **changed)})
    robot = load_robot(section.robot)
    plans = shipped_plans()
    factors, simulated_s, events, pairs, started_s = [], 0.0, 0, 0, time.perf_counter()
    for number in range(first, first + count):
        plan = plans[number % len(plans)]
        begin_s = time.perf_counter()
        try:
            scene, episode = stage._run(
                plan, walls_of(plan.plan_id), section, robot, default_config().seed, number // len(plans)
            )
        except FloorplanError:  # no room for two starts among this furniture
            continue
        pairs += len(_rows(scene, episode, f"{plan.plan_id}-{number}"))
        factors.append(episode.simulated_s / (time.perf_counter() - begin_s))
        simulated_s += episode.simulated_s
        events += len(episode.events)
    elapsed_s = time.perf_counter() - started_s
    return {
        "episodes": len(factors),
        "real_time_factor": round(simulated_s / elapsed_s, 1),
        "real_time_factor_median": round(statistics.median(factors), 1),
        "simulated_s_per_episode": round(simulated_s / len(factors), 1),
        "episodes_per_core_hour": round(3600 * len(factors) / elapsed_s),
        "events_per_core_hour": round(3600 * events / elapsed_s),
        "pairs_per_core_hour": round(3600 * pairs / elapsed_s),
    }


def _rows(scene: Any, episode: Any, episode_id: str) -> list[dict[str, Any]]:
    return list(sighting_rows(scene, episode, episode_id=episode_id, seed=0))


_PARTS = (
    (Physics, "__init__", "physics"),
    (Physics, "step", "physics"),
    (episode_room, "cast_rays", "lidar"),
    (episode_room, "noisy_ranges", "lidar"),
    (Slam, "update", "slam"),
    (Explorer, "twist", "planning and driving"),
    (episode_room, "sight", "sighting"),
    (stage, "furnish", "furnishing"),
    (stage, "furnished", "furnishing"),
    (stage, "draw_starts", "furnishing"),
    (sys.modules[__name__], "_rows", "encoding and metrics"),
)
