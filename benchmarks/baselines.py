"""Time per pair of each baseline on sightings in shipped plans; the search beside exhaustive ones."""

from __future__ import annotations

import argparse
import math
import statistics
import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.fft import irfft2, next_fast_len, rfft2

from benchmarks.scene import default_config, shipped_plans, walls_of
from rendezvous.alignment.estimate import FrameErrorEstimator, Identity
from rendezvous.alignment.frame_error import perturbed
from rendezvous.alignment.window import DEFAULT_SEARCH, OCCUPIED_CELL, MapWindow, SearchRange, map_window
from rendezvous.baselines.branch_and_bound import best_cell, block_bounds
from rendezvous.baselines.correlation import Correlation
from rendezvous.baselines.correlative import CorrelativeSearch
from rendezvous.baselines.hough import HoughSpectrum
from rendezvous.baselines.orb import OrbRansac
from rendezvous.errors import FloorplanError
from rendezvous.geometry.occupancy_grid import grid_from_png
from rendezvous.geometry.se2 import SE2
from rendezvous.robot_file import load_robot
from rendezvous.seeds import stream
from rendezvous.stages import explore as stage
from rendezvous.stages.dataset.sightings import sighting_rows

PAIRS = 6
REPEATS = 3
FULL_CIRCLE = SearchRange(xy_m=DEFAULT_SEARCH.xy_m, yaw_rad=math.pi)

Cell = tuple[int, int, int]


def measure(options: argparse.Namespace) -> dict[str, Any]:
    """Median milliseconds per pair, and how many times faster than exhaustive ones the search is."""
    windows = [_window(row, number) for number, row in enumerate(_first_sightings())]
    search = CorrelativeSearch()
    methods: list[FrameErrorEstimator] = [
        Identity(),
        HoughSpectrum(),
        HoughSpectrum(search=DEFAULT_SEARCH),
        OrbRansac(),
        replace(search, subcell=False),
        search,
    ]
    labels = [m.name for m in methods[:4]] + ["correlative search, cell", "correlative search"]
    return {
        "pairs": len(windows),
        "ms_per_pair": {
            label: _median_ms([lambda w=w, m=method: m(w) for w in windows])  # type: ignore[misc]
            for label, method in zip(labels, methods, strict=True)
        },
        "best_cell": _beside_exhaustive(search, windows, fourier=True),
        "best_cell_of_the_full_circle": _beside_exhaustive(
            replace(search, search=FULL_CIRCLE), windows, fourier=False
        ),
    }


def _beside_exhaustive(
    search: CorrelativeSearch, windows: list[MapWindow], *, fourier: bool
) -> dict[str, Any]:
    """The search without refinement below the cell, scores included; all ways must find the same cells."""
    ways: dict[str, Callable[[MapWindow], Cell]] = {
        "branch and bound": lambda window: _branch_and_bound(search.correlation(window)),
        "exhaustive, same code": lambda window: _exhaustive(search.correlation(window)),
    }
    if fourier:
        ways["exhaustive, Fourier"] = lambda window: _fourier(search.correlation(window))
    found = [[way(window) for window in windows] for way in ways.values()]
    assert all(cells == found[0] for cells in found)
    ms = {name: _median_ms([lambda w=w, f=way: f(w) for w in windows]) for name, way in ways.items()}  # type: ignore[misc]
    return {
        "ms_per_pair": ms,
        "times_faster": {name: round(value / ms["branch and bound"], 1) for name, value in ms.items()},
    }


def _branch_and_bound(scores: Correlation) -> Cell:
    best = best_cell(scores, block_bounds(scores))
    assert best is not None
    return best.heading, best.row, best.col


def _exhaustive(scores: Correlation) -> Cell:
    side = 2 * scores.reach + 1
    volume = np.stack([scores.scores(h, 0, 0, side, side) for h in range(len(scores.headings_rad))])
    return _first_best(volume)


def _fourier(scores: Correlation) -> Cell:
    """Correlate by products of spectra, one pair for each heading."""
    side = 2 * scores.reach + 1
    length = next_fast_len(max(len(scores.field_0), *scores.fields_1[0].shape), real=True)
    field_0 = rfft2(scores.field_0, (length, length))
    walls_0 = rfft2(_drawn(scores.walls_0, length))
    volume = []
    for walls_1, field_1 in zip(scores.walls_1, scores.fields_1, strict=True):
        product = field_0 * rfft2(_drawn(walls_1, length)).conj()
        product += rfft2(field_1, (length, length)) * walls_0.conj()
        volume.append(irfft2(product, (length, length))[:side, :side])
    return _first_best(np.rint(volume))


def _drawn(points: Any, length: int) -> Any:
    image = np.zeros((length, length))
    image[points[:, 0], points[:, 1]] = 1.0
    return image


def _first_best(volume: Any) -> Cell:
    heading, row, col = np.unravel_index(volume.argmax(), volume.shape)
    return int(heading), int(row), int(col)


def _median_ms(calls: list[Callable[[], object]]) -> float:
    """Median over the calls of the least processor time of several tries: other work only adds to it."""
    best_s = []
    for call in calls:
        times_s = []
        for _ in range(REPEATS):
            started_s = time.process_time()
            call()
            times_s.append(time.process_time() - started_s)
        best_s.append(min(times_s))
    return round(1e3 * statistics.median(best_s), 2)


def _first_sightings() -> list[dict[str, Any]]:
    """The first sighting of an episode in each of the first shipped plans that have room for one."""
    section = default_config().explore
    robot = load_robot(section.robot)
    rows = []
    for plan in shipped_plans():
        try:
            scene, episode = stage._run(
                plan, walls_of(plan.plan_id), section, robot, default_config().seed, 0
            )
        except FloorplanError:  # no room for two starts among this furniture
            continue
        rows += list(sighting_rows(scene, episode, episode_id=plan.plan_id, seed=0))[:1]
        if len(rows) == PAIRS:
            break
    return rows


def _window(row: dict[str, Any], number: int) -> MapWindow:
    """The window on a sighting, with a frame error drawn uniformly from the paper's range."""
    grids = [
        grid_from_png(row[f"map_{i}"], resolution_m=row["resolution_m"], T_m_g=row[f"origin_{i}"])
        for i in "01"
    ]
    rng = stream(0, "bench", str(number))
    theta = SE2(*rng.uniform(-2.0, 2.0, 2), rng.uniform(-math.pi / 4, math.pi / 4))
    T_true = row["T_m0_m1_local"]
    T_estimated, T_m0_c = perturbed(T_true, T_true @ row["T_m1_r1"], theta)
    turn = SE2(0.0, 0.0, rng.uniform(-math.pi, math.pi))
    window = map_window(grids[0], grids[1], T_estimated, T_m0_c @ turn)
    assert all((cells == OCCUPIED_CELL).any() for cells in window.cells)
    return window
