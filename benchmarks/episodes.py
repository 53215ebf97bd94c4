"""The whole episode loop on one core: two robots, furniture, full noise, default preset."""

from __future__ import annotations

import argparse
import statistics
import time
from collections import defaultdict
from collections.abc import Callable
from typing import Any

from benchmarks.scene import default_config, shipped_plans, walls_of
from pipeline.errors import FloorplanError
from pipeline.exploration import episode as episode_room
from pipeline.exploration.explorer import Explorer
from pipeline.robot_file import load_robot
from pipeline.simulation.drive import Physics
from pipeline.slam.slam import Slam
from pipeline.stages import explore as stage
from pipeline.stages.sightings import sighting_rows


def measure(options: argparse.Namespace) -> dict[str, Any]:
    """Real-time factor and yield with nothing in the way; then the shares of time, with clocks around."""
    _run(0, 1, drive="wheels")  # compiles
    timed = {drive: _run(1, options.episodes, drive=drive) for drive in ("wheels", "planar")}
    with _Clocks() as clocks:
        started_s = time.perf_counter()
        _run(1, max(4, options.episodes // 4), drive="wheels")
        shares = clocks.shares(time.perf_counter() - started_s)
    return {**timed, "share_of_time": shares}


def _run(first: int, count: int, *, drive: str) -> dict[str, Any]:
    """Episodes of the shipped plans in turn."""
    section = default_config().explore
    section = section.model_copy(update={"episode": _with_drive(section.episode, drive)})
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
        pairs += len(list(sighting_rows(scene, episode, episode_id=f"{plan.plan_id}-{number}", seed=0)))
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


def _with_drive(parameters: Any, drive: str) -> Any:
    from dataclasses import replace

    from pipeline.simulation.world import Drive

    return replace(parameters, drive=Drive(drive))


class _Clocks:
    """Clocks around the parts of the loop while it is open; the innermost one runs."""

    PARTS = (
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
    )

    def __enter__(self) -> _Clocks:
        self._total_s: dict[str, float] = defaultdict(float)
        self._running: list[str] = []
        self._since_s = 0.0
        self._originals = [(owner, name, getattr(owner, name)) for owner, name, _ in self.PARTS]
        for (owner, name, part), (_, _, original) in zip(self.PARTS, self._originals, strict=True):
            setattr(owner, name, self._timed(original, part))
        self._sighting_rows = globals()["sighting_rows"]
        globals()["sighting_rows"] = self._timed(
            lambda *args, **kwargs: list(self._sighting_rows(*args, **kwargs)), "encoding and metrics"
        )
        return self

    def __exit__(self, *_: object) -> None:
        for owner, name, original in self._originals:
            setattr(owner, name, original)
        globals()["sighting_rows"] = self._sighting_rows

    def shares(self, elapsed_s: float) -> dict[str, float]:
        """Shares of the elapsed time; the rest is the loop itself."""
        shares = {part: total_s / elapsed_s for part, total_s in self._total_s.items()}
        shares["loop"] = 1.0 - sum(shares.values())
        return {part: round(share, 3) for part, share in sorted(shares.items(), key=lambda item: -item[1])}

    def _timed(self, function: Callable[..., Any], part: str) -> Callable[..., Any]:
        def timed(*args: Any, **kwargs: Any) -> Any:
            self._switch(part)
            try:
                return function(*args, **kwargs)
            finally:
                self._switch(None)

        return timed

    def _switch(self, part: str | None) -> None:
        now_s = time.perf_counter()
        if self._running:
            self._total_s[self._running[-1]] += now_s - self._since_s
        if part is None:
            self._running.pop()
        else:
            self._running.append(part)
        self._since_s = now_s
