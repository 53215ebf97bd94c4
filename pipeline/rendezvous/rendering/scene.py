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

TexturePool = Mapping[str, Image]  # textures by key: (H, W, 3) uint8, sRGB, tiling without a seam

MAX_LIGHTS, MAX_SHADOWS = 8, 2

NO_INSTANCE = -1  # id of pixels that show the background


class LightKind(StrEnum):
    """How a light spreads: parallel rays, a cone, or all directions."""

    DIRECTIONAL = "directional"
    SPOT = "spot"
    POINT = "point"


@dataclass(frozen=True, slots=True, kw_only=True)
class Material:
    """How a surface reflects (glTF's metallic-roughness model)."""

    base_colour_rgb: Rgb  # linear, 0..1; multiplies the texture
    # metallic, roughness: 0..1.
    metallic: float = 0.0
    roughness: float = 0.8
    texture: str | None = None  # key into the texture pool; None for a plain surface
    texture_scale_m: float = 1.0  # side of one repeat of the texture, on meshes without UVs

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
    """A mesh of the pool at a pose."""

    name: str  # unique in the scene; parts of one object share what precedes a slash: `r1/wheel_left`
    mesh: str  # key into the mesh pool
    T_w: Array  # (4, 4) pose in w, which may scale the mesh along its own axes
    material: Material | None = None  # its material; None for the mesh's own


@dataclass(frozen=True, slots=True, kw_only=True)
class Light:
    """A lamp."""

    kind: LightKind  # how it spreads
    T_w: Array  # (4, 4) pose in w; it shines along its -z axis
    colour_rgb: Rgb = (1.0, 1.0, 1.0)  # linear, 0..1
    # Illuminance [lx] of a directional light, luminous intensity [cd] of the others. Pi lx on a white matt
    # surface, straight on, just reaches white in the picture.
    intensity: float = 1.0
    casts_shadow: bool = False  # whether its light casts shadows; a point light cannot
    cone_rad: float = 0.7  # half angle of a spot's cone

    def __post_init__(self) -> None:
        if self.casts_shadow and self.kind == LightKind.POINT:
            raise PipelineError("light: a point light casts no shadow; make it a spot")


@dataclass(frozen=True, slots=True, kw_only=True)
class Scene:
    """Everything that a picture depends on."""

    camera: PinholeCamera  # intrinsics and size
    T_w_c: Array  # (4, 4) pose of the camera
    instances: tuple[Instance, ...]  # the meshes to draw
    lights: tuple[Light, ...] = ()  # at most MAX_LIGHTS, of which at most MAX_SHADOWS cast shadows
    ambient_rgb: Rgb = (0.0, 0.0, 0.0)  # light from all directions, linear
    background: Image | None = None  # (H, W, 3) uint8 behind everything, of the camera's size; None for black
    # The labelled robot: name of an instance, or what precedes the slash in its parts' names.
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
    """A picture and what its pixels show."""

    rgb: Image  # (H, W, 3) uint8, sRGB
    instance_ids: NDArray[np.int32]  # (H, W) index into the scene's instances; NO_INSTANCE for the background
    depth_m: NDArray[np.float32]  # (H, W) float32 [m] along the camera's axis; inf for the background


@dataclass(frozen=True, slots=True, kw_only=True)
class RobotView:
    """The robot as a picture shows it."""

    visibility: float  # visible pixels / pixels of the whole silhouette; 0 where nothing is seen
    # x0, y0, x1, y1 of the outer edges of the visible pixels; None where nothing is seen.
    box_px: tuple[float, float, float, float] | None
    visible_px: int  # number of visible pixels
    silhouette_px: int  # number of pixels that it would cover unobstructed on a large enough canvas


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
