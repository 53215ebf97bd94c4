"""A sheet of robots of one family, to see how far training images let a robot differ from its model."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from rendezvous.evaluation.pictures.canvas import encoded_png
from rendezvous.geometry.camera import Image, PinholeCamera, camera_pose
from rendezvous.geometry.se2 import Array
from rendezvous.rendering.draws import RobotDraws
from rendezvous.rendering.robot_family import ROBOT, Variant
from rendezvous.rendering.robot_model import robot_parts
from rendezvous.rendering.scene import Light, LightKind, Scene
from rendezvous.rendering.studio import Studio
from rendezvous.robot_file import load_robot, load_robot_model
from rendezvous.seeds import stream
from rendezvous.simulation.robot import RobotSpec
from rendezvous.store.disk import Disk

COLUMNS = 8
TILE_PX = 160
PAPER = 235  # grey of the background


def robot_sheet(robot: str, draws: RobotDraws, *, count: int, seed: int) -> Image:
    """(H, W, 3) uint8: robots in rows of eight, seen from all around and a little above; the first as built.

    Raises:
        ConfigError: there is no such robot, or it has no model.
        SetupError: rendering does not work on this machine.
    """
    parts = robot_parts(load_robot_model(robot), source=f"model of {robot}")
    spec = load_robot(robot)
    studio = Studio(stream(seed, "sheet", "textures"), spec, parts, variants=1)
    tiles = []
    for number in range(count):
        rng = stream(seed, "sheet", number)
        shown = studio.looks.draw(rng, draws, wear=1.0, variants=1) if number else studio.looks.as_built()
        tiles.append(studio.render(_scene(spec, shown, rng)))
    blank = np.full_like(tiles[0], PAPER)
    tiles += [blank] * (-count % COLUMNS)
    rows = [np.hstack(tiles[first : first + COLUMNS]) for first in range(0, len(tiles), COLUMNS)]
    return np.vstack(rows)


def write_robot_sheet(robot: str, draws: RobotDraws, out: Path, *, count: int, seed: int) -> Path:
    """Draw a sheet and write it as PNG.

    Raises:
        StoreError: the file cannot be written.
    """
    Disk(str(out.parent)).write(out.name, encoded_png(robot_sheet(robot, draws, count=count, seed=seed)))
    return out


def _scene(spec: RobotSpec, shown: Variant, rng: np.random.Generator) -> Scene:
    """A robot before paper, lit from behind the camera and from above; any heading, from a little above."""
    around_rad, above_rad = rng.uniform(-math.pi, math.pi), math.radians(rng.uniform(5.0, 30.0))
    largest_m = max(spec.cuboid.size_m)
    # The upper half of a tile is for masts and boxes.
    centre_m = np.array(spec.cuboid.centre_m)
    centre_m[2] += 0.12 * largest_m
    level = math.cos(above_rad)
    towards = np.array([level * math.cos(around_rad), level * math.sin(around_rad), math.sin(above_rad)])
    T_w_c = camera_pose(
        centre_m + 3.2 * largest_m * towards, np.array([0.0, above_rad, around_rad + math.pi])
    )
    f_px = 2.0 * TILE_PX
    camera = PinholeCamera(
        fx_px=f_px, fy_px=f_px, cx_px=0.5 * (TILE_PX - 1), cy_px=0.5 * (TILE_PX - 1), width_px=TILE_PX,
        height_px=TILE_PX,
    )  # fmt: skip
    return Scene(
        camera=camera,
        T_w_c=T_w_c,
        instances=shown.instances(np.eye(4)),
        lights=(_sun(T_w_c[:3, 2], 1.5), _sun(np.array([0.3, -0.2, -1.0]), 2.5)),
        ambient_rgb=(0.5, 0.5, 0.5),
        background=np.full((TILE_PX, TILE_PX, 3), PAPER, np.uint8),
        robot=ROBOT,
    )


def _sun(along: Array, intensity: float) -> Light:
    """Parallel light along a direction."""
    z = -along / np.linalg.norm(along)
    x = np.cross([0.0, 1.0, 0.0], z)
    x /= np.linalg.norm(x)
    T_w = np.eye(4)
    T_w[:3, :3] = np.stack([x, np.cross(z, x), z], axis=1)
    return Light(kind=LightKind.DIRECTIONAL, T_w=T_w, intensity=intensity)
