"""Scenes and their renderings: the contract between the code that draws scenes at random and the renderer.

World frame w: metres, z up, floor at z = 0. Camera frame c: OpenCV's (x right, y down, z forward).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
import trimesh
from numpy.typing import NDArray

from rendezvous.errors import PipelineError
from rendezvous.geometry.camera import Image, PinholeCamera
from rendezvous.geometry.se2 import Array

Rgb = tuple[float, float, float]

MeshPool = Mapping[str, tuple[trimesh.Trimesh, ...]]
"""Meshes by key, in parts of one material each; UVs, if a part has any, count repeats of a texture."""

TexturePool = Mapping[str, Image]
"""Textures by key: (H, W, 3) uint8, sRGB, tiling without a seam."""

MAX_LIGHTS, MAX_SHADOWS = 8, 2

NO_INSTANCE = -1
"""Id of pixels that show the background."""


class LightKind(StrEnum):
    """How a light spreads: parallel rays, a cone, or all directions."""

    DIRECTIONAL = "directional"
    SPOT = "spot"
    POINT = "point"


@dataclass(frozen=True, slots=True, kw_only=True)
class Material:
    """How a surface reflects (glTF's metallic-roughness model).

    Attributes:
        base_colour_rgb: linear, 0..1; multiplies the texture.
        metallic, roughness: 0..1.
        texture: key into the texture pool; None for a plain surface.
        texture_scale_m: side of one repeat of the texture, on meshes without UVs.
    """

    base_colour_rgb: Rgb
    metallic: float = 0.0
    roughness: float = 0.8
    texture: str | None = None
    texture_scale_m: float = 1.0

    def __post_init__(self) -> None:
        values = (*self.base_colour_rgb, self.metallic, self.roughness)
        if not (all(0.0 <= v <= 1.0 for v in values) and self.texture_scale_m > 0.0):
            raise PipelineError(
                f"material: colour {self.base_colour_rgb}, metallic {self.metallic}, roughness "
                f"{self.roughness}, texture scale {self.texture_scale_m} m; the first three lie in 0..1, "
                "the scale is positive"
            )


@dataclass(frozen=True, slots=True, kw_only=True)
class Instance:
    """A mesh of the pool at a pose.

    Attributes:
        name: unique in the scene; parts of one object share what precedes a slash: `r1/wheel_left`.
        mesh: key into the mesh pool.
        T_w: (4, 4) pose in w, which may scale the mesh along its own axes.
        material: its material; None for the mesh's own.
    """

    name: str
    mesh: str
    T_w: Array
    material: Material | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Light:
    """A lamp.

    Attributes:
        kind: how it spreads.
        T_w: (4, 4) pose in w; it shines along its -z axis.
        colour_rgb: linear, 0..1.
        intensity: illuminance [lx] of a directional light, luminous intensity [cd] of the others. Pi lx on a
            white matt surface, straight on, just reaches white in the picture.
        casts_shadow: whether its light casts shadows; a point light cannot.
        cone_rad: half angle of a spot's cone.
    """

    kind: LightKind
    T_w: Array
    colour_rgb: Rgb = (1.0, 1.0, 1.0)
    intensity: float = 1.0
    casts_shadow: bool = False
    cone_rad: float = 0.7

    def __post_init__(self) -> None:
        if self.casts_shadow and self.kind == LightKind.POINT:
            raise PipelineError("light: a point light casts no shadow; make it a spot")


@dataclass(frozen=True, slots=True, kw_only=True)
class Scene:
    """Everything that a picture depends on.

    Attributes:
        camera: intrinsics and size.
        T_w_c: (4, 4) pose of the camera.
        instances: the meshes to draw.
        lights: at most MAX_LIGHTS, of which at most MAX_SHADOWS cast shadows.
        ambient_rgb: light from all directions, linear.
        background: (H, W, 3) uint8 behind everything, of the camera's size; None for black.
        robot: the labelled robot: name of an instance, or what precedes the slash in its parts' names.
    """

    camera: PinholeCamera
    T_w_c: Array
    instances: tuple[Instance, ...]
    lights: tuple[Light, ...] = ()
    ambient_rgb: Rgb = (0.0, 0.0, 0.0)
    background: Image | None = None
    robot: str | None = None

    def __post_init__(self) -> None:
        names = [instance.name for instance in self.instances]
        if len(set(names)) != len(names):
            repeated = sorted({name for name in names if names.count(name) > 1})
            raise PipelineError(f"scene: more than one instance named {', '.join(repeated)}; must be unique")
        shadows = sum(light.casts_shadow for light in self.lights)
        if len(self.lights) > MAX_LIGHTS or shadows > MAX_SHADOWS:
            raise PipelineError(
                f"scene: {len(self.lights)} lights, {shadows} of them with shadows; "
                f"at most {MAX_LIGHTS} and {MAX_SHADOWS}"
            )
        size = (self.camera.height_px, self.camera.width_px, 3)
        if self.background is not None and self.background.shape != size:
            raise PipelineError(f"scene: background of shape {self.background.shape}; the camera has {size}")

    def robot_ids(self) -> tuple[int, ...]:
        """Indices of the instances that make up the robot."""
        return tuple(
            i for i, instance in enumerate(self.instances) if instance.name.split("/")[0] == self.robot
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class Rendering:
    """A picture and what its pixels show.

    Attributes:
        rgb: (H, W, 3) uint8, sRGB.
        instance_ids: (H, W) int32, index into the scene's instances; NO_INSTANCE for the background.
        depth_m: (H, W) float32 [m] along the camera's axis; inf for the background.
    """

    rgb: Image
    instance_ids: NDArray[np.int32]
    depth_m: NDArray[np.float32]


@dataclass(frozen=True, slots=True, kw_only=True)
class RobotView:
    """The robot as a picture shows it.

    Attributes:
        visibility: visible pixels / pixels of the whole silhouette; 0 where nothing is seen.
        box_px: x0, y0, x1, y1 of the outer edges of the visible pixels; None where nothing is seen.
        visible_px: number of visible pixels.
        silhouette_px: number of pixels that it would cover unobstructed on a large enough canvas.
    """

    visibility: float
    box_px: tuple[float, float, float, float] | None
    visible_px: int
    silhouette_px: int


def robot_view(instance_ids: NDArray[np.int32], robot_ids: Sequence[int], *, silhouette_px: int) -> RobotView:
    """The view of the robot, by (H, W) instance ids and the ids that are the robot's."""
    visible = np.isin(instance_ids, robot_ids)
    visible_px = int(np.count_nonzero(visible))
    # Image and silhouette come from two passes, which may round a pixel at an edge differently.
    silhouette_px = max(silhouette_px, visible_px)
    if not visible_px:
        return RobotView(visibility=0.0, box_px=None, visible_px=0, silhouette_px=silhouette_px)
    rows, columns = np.flatnonzero(visible.any(axis=1)), np.flatnonzero(visible.any(axis=0))
    x0, y0, x1, y1 = (float(i) for i in (columns[0], rows[0], columns[-1], rows[-1]))
    return RobotView(
        visibility=visible_px / silhouette_px,
        box_px=(x0 - 0.5, y0 - 0.5, x1 + 0.5, y1 + 0.5),
        visible_px=visible_px,
        silhouette_px=silhouette_px,
    )
