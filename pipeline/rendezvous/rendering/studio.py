"""Takes pictures of drawn scenes, with their labels. All that is heavy to make stays resident."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import trimesh

from rendezvous.geometry.camera import Image
from rendezvous.geometry.cuboid import project_cuboid
from rendezvous.geometry.se2 import Array
from rendezvous.rendering.appearance.textures import texture_pool
from rendezvous.rendering.effects import apply_effects
from rendezvous.rendering.opengl.renderer import Renderer
from rendezvous.rendering.plan_scene import plan_meshes
from rendezvous.rendering.randomise import Drawn, robot_looks
from rendezvous.rendering.thing_meshes import thing_meshes
from rendezvous.rendering.visibility import RobotView
from rendezvous.simulation.robot import RobotSpec


@dataclass(frozen=True, slots=True, kw_only=True)
class Picture:
    """A picture and its label.

    Attributes:
        rgb: (H, W, 3) uint8, sRGB, as the camera gives it.
        T_c_o: (4, 4) pose of the robot's cuboid in the camera; None where there is no robot.
        projected_cuboid_px: (9, 2) its points in DOPE's order, NaN behind the camera; None likewise.
        view: how much of the robot shows, and where.
    """

    rgb: Image
    T_c_o: Array | None
    projected_cuboid_px: Array | None
    view: RobotView


class Studio:
    """One robot's looks, textures and a renderer that holds them: one for each process.

    Attributes:
        looks: the robot that is seen.
        textures: the texture pool.
    """

    def __init__(
        self,
        rng: np.random.Generator,
        robot: RobotSpec,
        parts: Mapping[str, trimesh.Trimesh],
        *,
        variants: int,
    ) -> None:
        """Make textures and upload everything.

        Args:
            rng: draws the textures.
            robot: dimensions of the robot that is seen, and of the camera that sees it.
            parts: its model's parts by name, in r.
            variants: textures of each kind.

        Raises:
            SetupError: rendering does not work on this machine.
        """
        self.looks, robot_meshes = robot_looks(robot, parts)
        self.textures = texture_pool(rng, variants=variants)
        self.camera = robot.camera.intrinsics()
        self._renderer = Renderer(
            {**plan_meshes(), **thing_meshes(), **robot_meshes},
            self.textures,
            width_px=self.camera.width_px,
            height_px=self.camera.height_px,
        )

    @property
    def robot(self) -> RobotSpec:
        """The robot that is seen."""
        return self.looks.spec

    def take(self, drawn: Drawn) -> Picture:
        """The picture of a scene and its label."""
        rendering = self._renderer.render(drawn.scene)
        T_c_o = drawn.T_c_o(self.robot.cuboid)
        return Picture(
            rgb=apply_effects(rendering.rgb, drawn.effects),
            T_c_o=T_c_o,
            projected_cuboid_px=(
                None if T_c_o is None else project_cuboid(T_c_o, self.robot.cuboid.size_m, self.camera)
            ),
            view=self._renderer.robot_view(drawn.scene, rendering),
        )
