"""Small scenes with known answers."""

from __future__ import annotations

from typing import Any

import numpy as np
import trimesh
from PIL import Image as PilImage

from rendezvous.geometry.camera import PinholeCamera, camera_pose, se3_from_se2
from rendezvous.geometry.se2 import SE2, Array
from rendezvous.rendering.plan_scene import BOX, plan_meshes
from rendezvous.rendering.scene import Instance, Light, LightKind, Material, MeshPool, Scene, TexturePool

CAMERA = PinholeCamera(fx_px=210.0, fy_px=205.0, cx_px=100.5, cy_px=71.0, width_px=208, height_px=144)
"""A small camera whose principal point is not the image's middle."""

WHITE = Material(base_colour_rgb=(1.0, 1.0, 1.0), roughness=1.0)
GREY = Material(base_colour_rgb=(0.3, 0.3, 0.3), roughness=1.0)
PLASTIC = Material(base_colour_rgb=(0.5, 0.5, 0.5))
CHECKED = Material(base_colour_rgb=(1.0, 1.0, 1.0), roughness=1.0, texture="checks", texture_scale_m=0.25)


def pool() -> MeshPool:
    """The plan's meshes, a marker, and a stand-in for a robot: 10,240 triangles in two parts."""
    ball = trimesh.creation.icosphere(subdivisions=4, radius=0.06)
    upper, lower = ball.copy(), ball.copy()
    upper.apply_translation([0.0, 0.0, 0.12])
    lower.apply_translation([0.02, 0.0, 0.06])
    marker = trimesh.creation.icosphere(subdivisions=2, radius=1.0)
    return {
        **plan_meshes(),
        "marker": (marker,),
        "robot": (upper, lower),
        "painted": (painted(),),
        "poster": (poster(),),
        "coloured": (coloured(),),
    }


def coloured() -> trimesh.Trimesh:
    """A square whose vertices are middle grey."""
    square = plan_meshes()["quad"][0].copy()
    square.visual.vertex_colors = np.full((4, 4), (128, 128, 128, 255), np.uint8)
    return square


def painted() -> trimesh.Trimesh:
    """A square of its own colour: linear, as glTF and trimesh keep it."""
    square = plan_meshes()["quad"][0].copy()
    material = trimesh.visual.material.PBRMaterial(
        baseColorFactor=[255, 51, 0, 255], metallicFactor=0.0, roughnessFactor=1.0
    )
    square.visual = trimesh.visual.TextureVisuals(material=material)
    return square


def poster() -> trimesh.Trimesh:
    """A square with a picture of its own, red left of the middle, and UVs that show it once."""
    square = plan_meshes()["quad"][0].copy()
    pixels = np.zeros((8, 8, 3), dtype=np.uint8)
    pixels[:, :4, 0] = 255
    material = trimesh.visual.material.PBRMaterial(
        baseColorTexture=PilImage.fromarray(pixels), metallicFactor=0.0, roughnessFactor=1.0
    )
    square.visual = trimesh.visual.TextureVisuals(uv=square.vertices[:, :2] + 0.5, material=material)
    return square


def textures() -> TexturePool:
    """Checks: one repeat is a black and a white one wide."""
    white = (np.indices((64, 64)) // 32).sum(axis=0) % 2 == 1
    return {"checks": np.repeat(np.where(white, 255, 0).astype(np.uint8)[:, :, None], 3, axis=2)}


def placed(
    mesh: str,
    xyz_m: tuple[float, float, float],
    *,
    size_m: tuple[float, float, float] = (1.0, 1.0, 1.0),
    yaw_rad: float = 0.0,
    name: str | None = None,
    material: Material | None = WHITE,
) -> Instance:
    """A mesh of the pool at a place, stretched along its axes."""
    T_w = se3_from_se2(SE2(xyz_m[0], xyz_m[1], yaw_rad))
    T_w[2, 3] = xyz_m[2]
    T_w[:3, :3] *= size_m
    return Instance(name=name or f"{mesh}/{xyz_m}", mesh=mesh, T_w=T_w, material=material)


def facing_x(*, height_m: float = 0.12) -> Array:
    """(4, 4) a camera over the origin that looks along x."""
    return camera_pose(np.array([0.0, 0.0, height_m]), np.zeros(3))


def looking_down(*, height_m: float) -> Array:
    """(4, 4) a camera over the origin that looks down, the top of its image towards x."""
    return camera_pose(np.array([0.0, 0.0, height_m]), np.array([0.0, 0.5 * np.pi, 0.0]))


def sun(*, towards: tuple[float, float, float] = (0.0, 0.0, -1.0), **fields: Any) -> Light:
    """Parallel light."""
    z = -np.array(towards) / np.linalg.norm(towards)
    x = np.cross([0.0, 1.0, 0.0], z) / np.linalg.norm(np.cross([0.0, 1.0, 0.0], z))
    T_w = np.eye(4)
    T_w[:3, :3] = np.stack([x, np.cross(z, x), z], axis=1)
    return Light(**{"kind": LightKind.DIRECTIONAL, "T_w": T_w, "intensity": np.pi, **fields})


def scene_of(*instances: Instance, **fields: Any) -> Scene:
    """A scene in front of the small camera, in ambient light by default."""
    defaults = {"camera": CAMERA, "T_w_c": facing_x(), "ambient_rgb": (0.5, 0.5, 0.5)}
    return Scene(**{**defaults, "instances": instances, **fields})


def crowded_scene(rng: np.random.Generator, *, camera: PinholeCamera = CAMERA, boxes: int = 40) -> Scene:
    """A robot amid boxes at random, in the light of the sun and a spot, with shadows."""
    things = [
        placed(
            BOX,
            (rng.uniform(0.5, 4.0), rng.uniform(-1.5, 1.5), rng.uniform(0.0, 0.4)),
            size_m=tuple(rng.uniform(0.05, 0.3, size=3)),
            yaw_rad=rng.uniform(0.0, np.pi),
            name=f"box/{i}",
            material=CHECKED if i % 2 else GREY,
        )
        for i in range(boxes)
    ]
    T_w_spot = sun().T_w
    T_w_spot[:3, 3] = 1.0, 0.0, 2.0
    spot = Light(kind=LightKind.SPOT, T_w=T_w_spot, intensity=6.0, casts_shadow=True)
    return scene_of(
        placed("quad", (0.0, 0.0, 0.0), size_m=(20.0, 20.0, 1.0), name="floor", material=CHECKED),
        placed("robot", (1.0, 0.05, 0.0), name="r1", material=PLASTIC),
        *things,
        camera=camera,
        lights=(spot, sun(towards=(0.3, 0.1, -1.0), intensity=1.5, casts_shadow=True)),
        robot="r1",
    )
