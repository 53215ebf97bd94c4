"""What stands in a scene as Blender's objects: parts of meshes, lamps, the camera."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from rendezvous.geometry.camera import PinholeCamera
from rendezvous.geometry.se2 import Array
from rendezvous.rendering.cycles.blender import blender
from rendezvous.rendering.cycles.resident import BlenderPart
from rendezvous.rendering.opengl.renderer import FAR_M, NEAR_M
from rendezvous.rendering.scene import Instance, Light, LightKind

LAMP_RADIUS_M, SUN_ANGLE_RAD = 0.06, 0.02
"""Size of lamps, which makes shadows soft; the sun is seen through thin clouds."""

SPOT_BLEND = 0.35
"""Share of a spot's cone, by cosine, in which it fades; as in `opengl.shaders`."""

SENSOR_MM = 36.0

T_OPENCV_BLENDER = np.diag([1.0, -1.0, -1.0, 1.0])
"""Blender's camera looks along -z, with y up."""


def is_ceiling(instance: Instance, part: BlenderPart) -> bool:
    """Whether it is a level sheet that faces down: from above it is invisible and lets light in."""
    down = -instance.T_w[2, 2] / np.linalg.norm(instance.T_w[:3, 2])
    return part.sheet and bool(down > 0.999)


def is_behind(instance: Instance, part: BlenderPart, T_w_c: Array) -> bool:
    """Whether it is a sheet of which the camera would see the back, where it is invisible."""
    return part.sheet and bool(instance.T_w[:3, 2] @ (T_w_c[:3, 3] - instance.T_w[:3, 3]) < 0.0)


def make_object(instance: Instance, part: BlenderPart, material: Any) -> Any:
    """A part of an instance; the mesh is shared."""
    made = blender().data.objects.new(instance.name, part.mesh)
    made.matrix_world = _matrix(instance.T_w)
    made.material_slots[0].link = "OBJECT"
    made.material_slots[0].material = material
    if is_ceiling(instance, part):
        made.visible_diffuse = made.visible_shadow = False
    return made


def make_lamp(light: Light) -> Any:
    """A lamp as bright as the OpenGL renderer's, with a size."""
    bpy = blender()
    kind = {LightKind.DIRECTIONAL: "SUN", LightKind.SPOT: "SPOT", LightKind.POINT: "POINT"}[light.kind]
    lamp = bpy.data.lights.new(light.kind, kind)
    lamp.color = light.colour_rgb
    if light.kind is LightKind.DIRECTIONAL:
        lamp.energy, lamp.angle = light.intensity, SUN_ANGLE_RAD
    else:
        # Blender's unit is the power of a lamp that shines in all directions, whatever a spot's cone.
        lamp.energy, lamp.shadow_soft_size = 4.0 * math.pi * light.intensity, LAMP_RADIUS_M
    if light.kind is LightKind.SPOT:
        lamp.spot_size, lamp.spot_blend = 2.0 * light.cone_rad, SPOT_BLEND
    made = bpy.data.objects.new(light.kind, lamp)
    made.matrix_world = _matrix(light.T_w)
    made.visible_camera = False
    return made


def set_camera(scene: Any, camera: PinholeCamera, T_w_c: Array) -> None:
    """Set the image's size and the camera of a Blender scene.

    In the image, pixel centres are whole numbers: its middle is at `(size - 1) / 2`.
    """
    width_px, height_px = camera.width_px, camera.height_px
    render, lens = scene.render, scene.camera.data
    render.resolution_x, render.resolution_y = width_px, height_px
    # A pixel's sides; neither may be below 1.
    render.pixel_aspect_x = max(camera.fy_px / camera.fx_px, 1.0)
    render.pixel_aspect_y = max(camera.fx_px / camera.fy_px, 1.0)
    lens.sensor_fit, lens.sensor_width = "HORIZONTAL", SENSOR_MM
    lens.lens = camera.fx_px * SENSOR_MM / width_px
    # Both in widths of the image.
    lens.shift_x = (0.5 * (width_px - 1) - camera.cx_px) / width_px
    lens.shift_y = (camera.cy_px - 0.5 * (height_px - 1)) / width_px * (camera.fx_px / camera.fy_px)
    lens.clip_start, lens.clip_end = NEAR_M, FAR_M
    scene.camera.matrix_world = _matrix(T_w_c @ T_OPENCV_BLENDER)


def _matrix(T: Array) -> Any:
    """A (4, 4) matrix as Blender takes it."""
    from mathutils import Matrix

    return Matrix(T.tolist())
