"""Takes labelled pictures of drawn scenes. Everything expensive to make stays resident."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import trimesh

from rendezvous.geometry.camera import Image
from rendezvous.geometry.cuboid import project_cuboid
from rendezvous.geometry.se2 import Array
from rendezvous.rendering.appearance.textures import texture_pool
from rendezvous.rendering.cycles.blender import cycles_name
from rendezvous.rendering.cycles.renderer import CyclesRenderer
from rendezvous.rendering.effects import apply_effects
from rendezvous.rendering.opengl.gl import renderer_name
from rendezvous.rendering.opengl.renderer import Renderer
from rendezvous.rendering.plan_scene import plan_meshes
from rendezvous.rendering.randomise import Drawn
from rendezvous.rendering.robot_family import robot_looks
from rendezvous.rendering.scene import RobotView, Scene
from rendezvous.rendering.thing_meshes import thing_meshes
from rendezvous.simulation.robot import RobotSpec


@dataclass(frozen=True, slots=True, kw_only=True)
class Picture:
    """A picture and its label."""

    rgb: Image  # (H, W, 3) uint8, sRGB, after the camera's effects
    T_c_o: Array | None  # (4, 4) pose of the robot's cuboid in the camera; None without a robot
    # (9, 2) its points in DOPE's order, NaN behind the camera; None without a robot.
    projected_cuboid_px: Array | None
    view: RobotView  # how much of the robot shows, and where


class Studio:
    """One robot's looks, textures, and a renderer that holds them; make one per process."""

    def __init__(
        self,
        rng: np.random.Generator,
        robot: RobotSpec,
        parts: Mapping[str, trimesh.Trimesh],
        *,
        variants: int,
        cycles_samples: int | None = None,
    ) -> None:
        """Make textures and upload everything.

        Args:
            rng: draws the textures.
            robot: the robot that is seen, and of the same make as the one that carries the camera.
            parts: parts of its model by name, in r.
            variants: number of textures of each kind.
            cycles_samples: light paths through each pixel of path-traced pictures; None for rasterised ones.

        Raises:
            SetupError: rendering does not work on this machine, or Blender is wanted and not installed.
        """
        self.looks, robot_meshes = robot_looks(robot, parts)
        self.textures = texture_pool(rng, variants=variants)
        self.camera = robot.camera.intrinsics()  # of the camera that sees it
        meshes = {**plan_meshes(), **thing_meshes(), **robot_meshes}
        self._renderer = Renderer(meshes, self.textures)
        self._path_tracer = (
            CyclesRenderer(meshes, self.textures, samples=cycles_samples) if cycles_samples else None
        )

    @property
    def robot(self) -> RobotSpec:
        """The robot that is seen."""
        return self.looks.spec

    def render(self, scene: Scene) -> Image:
        """The picture of a scene without the camera's effects, (H, W, 3) uint8."""
        return self._renderer.render(scene).rgb

    @property
    def renderer(self) -> str:
        """Name of what colours the pictures."""
        return cycles_name() if self._path_tracer else renderer_name()

    def take(self, drawn: Drawn) -> Picture:
        """Render a scene and label it; the label is the same whatever colours the picture."""
        rendering = self._renderer.render(drawn.scene)
        rgb = self._path_tracer.render(drawn.scene) if self._path_tracer else rendering.rgb
        T_c_o = drawn.T_c_o(self.robot.cuboid)
        size_m = self.robot.cuboid.size_m
        return Picture(
            rgb=apply_effects(rgb, drawn.effects),
            T_c_o=T_c_o,
            projected_cuboid_px=None if T_c_o is None else project_cuboid(T_c_o, size_m, drawn.scene.camera),
            view=self._renderer.robot_view(drawn.scene, rendering),
        )
