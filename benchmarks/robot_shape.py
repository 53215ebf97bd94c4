"""How like the maker's meshes the Burger's model is: silhouettes and depth from 200 views.

The meshes (ROBOTIS turtlebot3_description, Intel realsense2_description) are not part of the project; they
are looked for in `robot/` of the folder that RENDEZVOUS_TEST_DATA names. They have no cables, plugs or chips,
so the body is compared without ours too.
"""

from __future__ import annotations

import argparse
import importlib.util
import math
import os
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import trimesh

from rendezvous.geometry.camera import PinholeCamera, camera_pose
from rendezvous.geometry.se2 import Array
from rendezvous.rendering.opengl.renderer import Renderer
from rendezvous.rendering.robot_model import nominal_parts, robot_parts
from rendezvous.rendering.scene import NO_INSTANCE, Instance, Scene
from rendezvous.robot_file import load_robot, load_robot_model

VIEWS = 200
CAMERA = PinholeCamera(fx_px=1400.0, fy_px=1400.0, cx_px=319.5, cy_px=239.5, width_px=640, height_px=480)
RANGE_M = 0.75
ADDED = ("cable", "chip", "plug", "sticker")
"""Kinds of parts that the maker's meshes do not have."""

NO_MESHES = "no meshes of the maker; RENDEZVOUS_TEST_DATA must name the folder above robot/"


def measure(options: argparse.Namespace) -> dict[str, object]:
    """Intersection over union of silhouettes and error of depth, with and without parts added to the mesh."""
    del options
    folder = maker_folder()
    if folder is None:
        return {"skipped": NO_MESHES}
    spec = load_robot("burger")
    theirs = maker_parts(folder)
    camera = "camera" in theirs
    parts = nominal_parts(robot_parts(load_robot_model("burger"), source="burger"))
    ours = {n: p for n, p in parts.items() if camera or not n.startswith("camera")}
    body = {n: p for n, p in ours.items() if n.split(".")[0] not in ADDED}
    centre_m = np.array(spec.cuboid.centre_m)
    return {
        "views": VIEWS,
        "camera_compared": camera,
        "body": compare(body, theirs, centre_m),
        "whole": compare(ours, theirs, centre_m),
    }


def maker_folder() -> Path | None:
    """The folder of the maker's meshes; None if there is none."""
    given = os.environ.get("RENDEZVOUS_TEST_DATA")
    folder = Path(given) / "robot" if given else None
    return folder if folder is not None and folder.is_dir() else None


def maker_parts(folder: Path) -> dict[str, trimesh.Trimesh]:
    """The maker's meshes in r [m], placed as their URDF does; the D435 if pycollada is installed."""
    base = trimesh.load(folder / "base_link.glb", force="mesh").apply_translation([0.0, 0.0, 0.010])
    lidar = trimesh.load(folder / "lds.stl").apply_scale(1e-3).apply_translation([-0.032, 0.0, 0.182])
    left = trimesh.load(folder / "left_tire.stl").apply_scale(1e-3)
    right = left.copy().apply_transform(np.diag([1.0, -1.0, 1.0, 1.0]))
    parts = {
        "base": base,
        "lidar": lidar,
        "left": left.apply_translation([0.0, 0.080, 0.033]),
        "right": right.apply_translation([0.0, -0.080, 0.033]),
    }
    if importlib.util.find_spec("collada"):
        camera = trimesh.load(folder / "d435.dae", force="mesh")
        # The mesh's y is along the body, x forward and z up; its face is to be flush with the plates' front.
        camera.apply_translation([0.037 - camera.bounds[1, 0], -0.0325, 0.120 - camera.bounds[:, 2].mean()])
        parts["camera"] = camera
    return parts


def compare(
    ours: Mapping[str, trimesh.Trimesh], theirs: Mapping[str, trimesh.Trimesh], centre_m: Array
) -> dict[str, float]:
    """Agreement over views from all around, 5 degrees below to 60 degrees above the robot's middle."""
    renderer = Renderer({"ours": tuple(ours.values()), "theirs": tuple(theirs.values())}, {})
    ious, depth_m = [], []
    for i in range(VIEWS):
        around = i * math.pi * (3.0 - math.sqrt(5.0))
        above = math.radians(-5.0 + 65.0 * (i + 0.5) / VIEWS)
        towards = -np.array(
            [math.cos(above) * math.cos(around), math.cos(above) * math.sin(around), math.sin(above)]
        )
        T_w_c = camera_pose(centre_m - RANGE_M * towards, np.array([0.0, above, around + math.pi]))
        masks, depths = [], []
        for key in ("ours", "theirs"):
            scene = Scene(
                camera=CAMERA, T_w_c=T_w_c, instances=(Instance(name=key, mesh=key, T_w=np.eye(4)),)
            )
            rendering = renderer.render(scene)
            masks.append(rendering.instance_ids != NO_INSTANCE)
            depths.append(rendering.depth_m)
        both = masks[0] & masks[1]
        ious.append(both.sum() / (masks[0] | masks[1]).sum())
        depth_m.append(float(np.median(np.abs(depths[0] - depths[1])[both])))
    return {
        "iou_median": round(float(np.median(ious)), 4),
        "iou_worst_tenth": round(float(np.quantile(ious, 0.1)), 4),
        "depth_error_median_mm": round(1e3 * float(np.median(depth_m)), 2),
    }
