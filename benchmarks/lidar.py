"""One lidar scan of 360 beams in a furnished plan: ours and the alternatives, side by side."""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable
from typing import Any

import mujoco
import numpy as np

from benchmarks.clocks import side_by_side_s
from benchmarks.scene import default_config, shipped_plans, walls_of
from rendezvous.floorplan.furnish import furnish
from rendezvous.floorplan.validate import start_regions
from rendezvous.floorplan.walls import lidar_outline
from rendezvous.geometry.se2 import SE2, Array
from rendezvous.robot_file import load_robot
from rendezvous.seeds import stream
from rendezvous.simulation.rays import cast_rays, ray_scene
from rendezvous.simulation.robot import beam_bearings
from rendezvous.simulation.world import scene_mjcf

REPEATS = 15


def measure(options: argparse.Namespace) -> dict[str, Any]:
    """Median microseconds per scan, and how many times ours is faster."""
    plan = shipped_plans()[0]
    robot = load_robot(default_config().explore.robot)
    furniture = furnish(plan, stream(0, "bench"), density=1.0, robot_radius_m=robot.radius_m)
    bearings = beam_bearings(robot.lidar)
    at = start_regions(plan, robot_radius_m=robot.radius_m)[0].representative_point()
    scene = ray_scene(*lidar_outline(plan, furniture, height_m=robot.lidar.z_m))
    pose = np.tile([at.x, at.y, 0.1], (robot.lidar.beams, 1))
    height_m = robot.lidar.z_m
    low = [solid for solid in furniture if solid.z0_m <= height_m <= solid.z1_m]
    model = mujoco.MjModel.from_xml_string(
        scene_mjcf([*walls_of(plan.plan_id), *low], [robot], [SE2(100.0, 100.0, 0.0)])
    )
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    eye = np.array([at.x, at.y, height_m])
    directions = np.stack([np.cos(0.1 + bearings), np.sin(0.1 + bearings), np.zeros(len(bearings))], axis=1)
    ways: dict[str, Callable[[], Array]] = {
        "rendezvous": lambda: cast_rays(scene, pose, bearings, max_range_m=10.0),
        "mj_multiRay": lambda: _multi_ray(model, data, eye, directions),
        "numpy": lambda: _numpy(scene.segments_m, scene.circles_m, eye, directions),
        "mj_ray in a loop": lambda: _ray_loop(model, data, eye, directions),
    }
    ours = ways["rendezvous"]()
    agreement_m = {name: float(np.nanmax(np.abs(cast() - ours))) for name, cast in ways.items()}
    times_us = {name: 1e6 * v for name, v in side_by_side_s(ways, repeats=REPEATS, calls=10).items()}
    return {
        "segments": len(scene.segments_m),
        "circles": len(scene.circles_m),
        "us_per_scan": {name: round(value, 1) for name, value in times_us.items()},
        "times_faster": {name: round(v / times_us["rendezvous"], 1) for name, v in times_us.items()},
        "largest_difference_m": {name: float(f"{value:.1e}") for name, value in agreement_m.items()},
    }


def _multi_ray(model: Any, data: Any, eye: Array, directions: Array) -> Array:
    n = len(directions)
    distance, geom = np.empty(n), np.empty(n, np.int32)
    mujoco.mj_multiRay(
        model, data, eye, directions.ravel(), None, 1, -1, geom, distance, None, n, mujoco.mjMAXVAL
    )
    return np.where(geom >= 0, distance, np.inf)


def _ray_loop(model: Any, data: Any, eye: Array, directions: Array) -> Array:
    geom = np.zeros(1, np.int32)
    return np.array([mujoco.mj_ray(model, data, eye, d, None, 1, -1, geom) for d in directions])


def _numpy(segments_m: Array, circles_m: Array, eye: Array, directions: Array) -> Array:
    """Intersect all beams with all segments and circles at once."""
    d = directions[:, None, :2]
    start, edge = segments_m[:, :2] - eye[:2], segments_m[:, 2:] - segments_m[:, :2]
    cross = d[..., 0] * edge[:, 1] - d[..., 1] * edge[:, 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        t = (start[:, 0] * edge[:, 1] - start[:, 1] * edge[:, 0]) / cross
        u = (start[:, 0] * d[..., 1] - start[:, 1] * d[..., 0]) / cross
        best = np.where((t >= 0) & (u >= 0) & (u <= 1), t, math.inf).min(axis=1)
        to = circles_m[:, :2] - eye[:2]
        b = d[..., 0] * to[:, 0] + d[..., 1] * to[:, 1]
        root = np.sqrt(b * b - (to**2).sum(axis=1) + circles_m[:, 2] ** 2)
        hit = np.where((b - root >= 0) & ~np.isnan(root), b - root, math.inf).min(axis=1)
    return np.minimum(best, hit)
