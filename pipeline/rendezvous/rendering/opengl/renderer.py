"""Renders scenes: the picture, and what each pixel shows. The only module that uses OpenGL's axes.

pyrender opens the context; the passes are our own. pyrender's renderer draws node by node and also shades
what is hidden: for 150 boxes and a robot of 20,000 triangles at 640x480 px, colour and segmentation took it
177 ms of one core (288 ms with one shadow) against 65 ms (73 ms) here. It also visits nodes and lights in the
order of sets, which varies between processes and shows in the picture by rounding. Here meshes and textures
are uploaded once, and one call draws all instances of a mesh, in the order of the pool and the scene.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import trimesh
from numpy.typing import NDArray

from rendezvous.geometry.camera import Image, PinholeCamera
from rendezvous.geometry.se2 import Array
from rendezvous.rendering.opengl.gl import headless_context
from rendezvous.rendering.opengl.shaders import ROW_TEXELS
from rendezvous.rendering.scene import (
    NO_INSTANCE,
    Instance,
    Light,
    LightKind,
    Material,
    MeshPool,
    Rendering,
    RobotView,
    Scene,
    TexturePool,
    robot_view,
)

if TYPE_CHECKING:
    from rendezvous.rendering.opengl.gl_objects import Uniform
    from rendezvous.rendering.opengl.passes import DrawCall, Passes
    from rendezvous.rendering.opengl.resident import Float32

NEAR_M, FAR_M = 0.02, 60.0  # only what is between these distances from the camera is drawn

SHADOW_AHEAD_M, SHADOW_HALF_M = 2.2, 3.2
"""Shadows of parallel light fall in a box of this half width, centred this far ahead of the camera."""

SHADOW_DEPTH_M = 20.0

CANVAS_MARGIN = 2  # silhouettes are counted up to this many image sizes beyond each edge of the image

CREASE = 2e-6  # second difference of buffer depth above which a pixel is on a crease; depth has steps of 6e-8


class Renderer:
    """Renders scenes from resident pools of meshes and textures.

    Make one per process: what it uploads stays until the process ends.
    """

    def __init__(self, meshes: MeshPool, textures: TexturePool) -> None:
        """Upload the pools.

        Raises:
            SetupError: a system library is missing, or no device can be opened.
        """
        headless_context()
        # Only now: on import PyOpenGL binds itself to a platform, and fails if libraries are missing.
        from rendezvous.rendering.opengl.resident import ResidentPools

        self._pools = ResidentPools(meshes, textures)
        self._corners = {
            key: np.concatenate([trimesh.bounds.corners(part.bounds) for part in parts])
            for key, parts in meshes.items()
        }
        self._passes_by_size: dict[tuple[int, int], Passes] = {}

    def _passes(self, camera: PinholeCamera) -> Passes:
        """The passes for the camera's image size; those of a size stay."""
        from rendezvous.rendering.opengl.passes import Passes

        size = (camera.width_px, camera.height_px)
        if size not in self._passes_by_size:
            self._passes_by_size[size] = Passes(
                width_px=size[0],
                height_px=size[1],
                vertex_array=self._pools.vertex_array,
                texture_array=self._pools.texture_array,
            )
        return self._passes_by_size[size]

    def render(self, scene: Scene) -> Rendering:
        """Render a scene.

        Raises:
            PipelineError: a mesh or texture is not in its pool.
        """
        camera = scene.camera
        passes = self._passes(camera)
        self._upload(passes, enumerate(scene.instances))
        T_clip_w = clip_matrix(camera) @ np.linalg.inv(scene.T_w_c)
        size = {"width_px": camera.width_px, "height_px": camera.height_px}
        ids = passes.ids(T_clip_w, **size)
        depth = passes.depth()
        shadowed, others = (
            [light for light in scene.lights if light.casts_shadow is shadow] for shadow in (True, False)
        )
        T_shadow_w = np.array([_shadow_matrix(light, scene.T_w_c) for light in shadowed])
        light = {
            **_light_uniforms([*shadowed, *others]),
            "camera_w": scene.T_w_c[:3, 3],
            "ambient": np.array(scene.ambient_rgb),
            "contact": self._contact(scene),
        }
        rgba = passes.colour(T_clip_w, T_shadow_w, light, _edges(ids, depth))
        return Rendering(rgb=_over(rgba, scene.background), instance_ids=ids, depth_m=_metres(depth))

    def silhouette_px(self, scene: Scene) -> int:
        """Number of pixels that the robot alone covers on a canvas larger than the image; see CANVAS_MARGIN.

        The canvas continues the image's own pixel grid; only its tiles around the robot are drawn.
        """
        robot = [(i, scene.instances[i]) for i in scene.robot_ids()]
        if not robot:
            return 0
        passes, width, height = self._passes(scene.camera), scene.camera.width_px, scene.camera.height_px
        self._upload(passes, robot)
        T_c_w = np.asarray(np.linalg.inv(scene.T_w_c), dtype=np.float64)
        x0, y0, x1, y1 = self._extent_px(scene.camera, T_c_w, [instance for _, instance in robot])
        count = 0
        for y in range(y0, y1, height):
            for x in range(x0, x1, width):
                width_px, height_px = min(width, x1 - x), min(height, y1 - y)
                size = {"width_px": width_px, "height_px": height_px}
                tile = replace(
                    scene.camera, cx_px=scene.camera.cx_px - x, cy_px=scene.camera.cy_px - y, **size
                )
                T_clip_w = clip_matrix(tile) @ T_c_w
                ids = passes.ids(T_clip_w, **size)
                count += int(np.count_nonzero(ids != NO_INSTANCE))
        return count

    def robot_view(self, scene: Scene, rendering: Rendering) -> RobotView:
        """The view of the robot in a rendering of this scene."""
        return robot_view(rendering.instance_ids, scene.robot_ids(), silhouette_px=self.silhouette_px(scene))

    def _upload(self, passes: Passes, instances: Iterable[tuple[int, Instance]]) -> None:
        """Hand over the table of these instances, by id, grouped by mesh in the order of the pool."""
        from rendezvous.rendering.opengl.passes import DrawCall

        by_mesh: dict[str, list[tuple[int, Instance]]] = {key: [] for key in self._pools.parts}
        for i, instance in instances:
            self._pools.parts_of(instance.mesh)
            by_mesh[instance.mesh].append((i, instance))
        rows: list[tuple[float, ...]] = []
        draws: list[DrawCall] = []
        for key, members in by_mesh.items():
            for part in self._pools.parts_of(key) if members else ():
                draws.append(DrawCall(part=part, first_row=len(rows), count=len(members)))
                for i, instance in members:
                    material = instance.material or part.material
                    rows.append(_row(i, instance, material, self._pools.layer(material.texture)))
        passes.upload(draws, np.array(rows, dtype=np.float32).reshape(-1, 4 * ROW_TEXELS))

    def _contact(self, scene: Scene) -> Array:
        """(4,) x, y, z of the centre of the robot's footprint and its radius [m]; zeros without a robot."""
        robot = [scene.instances[i] for i in scene.robot_ids()]
        if not robot:
            return np.zeros(4)
        corners_w = self._corners_w(robot)
        low, high = corners_w.min(axis=0), corners_w.max(axis=0)
        x, y, _ = 0.5 * (low + high)
        return np.array([x, y, low[2], 0.25 * float((high - low)[:2].sum())])

    def _corners_w(self, instances: Sequence[Instance]) -> Array:
        """(N, 3) [m] corners of the instances' bounding boxes."""
        return np.concatenate([self._corners[i.mesh] @ i.T_w[:3, :3].T + i.T_w[:3, 3] for i in instances])

    def _extent_px(
        self, camera: PinholeCamera, T_c_w: Array, instances: Sequence[Instance]
    ) -> tuple[int, int, int, int]:
        """x0, y0, x1, y1 in whole pixels around the instances' bounding boxes, within the canvas."""
        size = np.array([camera.width_px, camera.height_px])
        low, high = -CANVAS_MARGIN * size, (1 + CANVAS_MARGIN) * size
        corners_c = self._corners_w(instances) @ T_c_w[:3, :3].T + T_c_w[:3, 3]
        # What reaches behind the image plane has no outline in it: use all of the canvas.
        if corners_c[:, 2].min() > NEAR_M:
            uv_px = camera.project(corners_c)
            low = np.maximum(np.floor(uv_px.min(axis=0)), low)
            high = np.minimum(np.ceil(uv_px.max(axis=0)) + 1.0, high)
        return int(low[0]), int(low[1]), int(high[0]), int(high[1])


def clip_matrix(camera: PinholeCamera) -> Array:
    """(4, 4) from camera frame c to clip space, with row 0 of the image at the bottom.

    Pixel centres are whole numbers, so the image's edge at -0.5 is -1 in clip space.
    """
    width, height = camera.width_px, camera.height_px
    span_m = FAR_M - NEAR_M
    return np.array(
        [
            [2.0 * camera.fx_px / width, 0.0, 2.0 * (camera.cx_px + 0.5) / width - 1.0, 0.0],
            [0.0, 2.0 * camera.fy_px / height, 2.0 * (camera.cy_px + 0.5) / height - 1.0, 0.0],
            [0.0, 0.0, (FAR_M + NEAR_M) / span_m, -2.0 * FAR_M * NEAR_M / span_m],
            [0.0, 0.0, 1.0, 0.0],
        ]
    )


def _edges(ids: NDArray[np.int32], depth: Float32) -> NDArray[np.bool_]:
    """(H, W) pixels on an outline or a crease, which take more than one sample.

    Buffer depth is linear in 1 / z, so it is linear across the image of a plane: where its second difference
    is not zero, two surfaces meet.
    """
    edges = np.zeros(ids.shape, dtype=bool)
    for axis in (0, 1):
        image, changes = np.moveaxis(ids, axis, 0), np.moveaxis(edges, axis, 0)
        differs = image[1:] != image[:-1]
        changes[1:] |= differs
        changes[:-1] |= differs
        d = np.moveaxis(depth, axis, 0)
        bend = np.abs(d[2:] + d[:-2] - 2.0 * d[1:-1]) > CREASE
        changes[1:-1] |= bend
    return edges


def _metres(depth: Float32) -> Float32:
    """Distance along the camera's axis from buffer depth in 0..1; inf where nothing is."""
    # float32: its rounding matters only tens of metres away.
    depth_m = (FAR_M * NEAR_M) / (FAR_M - depth * np.float32(FAR_M - NEAR_M))
    depth_m[depth >= 1.0] = np.inf
    return depth_m


def _over(rgba: Image, background: Image | None) -> Image:
    """The picture in front of its background."""
    rgb = np.ascontiguousarray(rgba[:, :, :3])
    if background is not None:
        open_ = rgba[:, :, 3] < 255
        through = 1.0 - rgba[open_, 3:] / 255.0
        rgb[open_] = np.round(rgb[open_] + through * background[open_]).astype(np.uint8)
    return rgb


def _row(i: int, instance: Instance, material: Material, layer: int) -> tuple[float, ...]:
    """One row of the table of instances; see `shaders`."""
    return (
        *instance.T_w[:3].ravel(),
        *material.base_colour_rgb,
        material.metallic,
        material.roughness,
        layer,
        material.texture_scale_m,
        i,
    )


def _light_uniforms(lights: Sequence[Light]) -> dict[str, Uniform]:
    """The lights as the surface shader reads them; those with shadows must come first."""
    place, direction, colour = [], [], []
    for light in lights:
        directional, spot = light.kind == LightKind.DIRECTIONAL, light.kind == LightKind.SPOT
        place.append((*light.T_w[:3, 3], 0.0 if directional else 1.0))
        direction.append((*-light.T_w[:3, 2], np.cos(light.cone_rad) if spot else -1.0))
        colour.append((*(light.intensity * np.array(light.colour_rgb)), 0.0))
    uniforms = {"light_place": place, "light_direction": direction, "light_colour": colour}
    return {"light_count": len(lights), **{name: np.array(values) for name, values in uniforms.items()}}


def _shadow_matrix(light: Light, T_w_c: Array) -> Array:
    """(4, 4) from w to the clip space of the light's view."""
    # A light has OpenGL's axes (y up, shines along -z); with y down and z forward it is one of our cameras.
    T_w_l = light.T_w @ np.diag([1.0, -1.0, -1.0, 1.0])
    if light.kind == LightKind.SPOT:
        focal = 1.0 / np.tan(light.cone_rad)
        camera = PinholeCamera(
            fx_px=0.5 * focal, fy_px=0.5 * focal, cx_px=0.0, cy_px=0.0, width_px=1, height_px=1
        )
        return clip_matrix(camera) @ np.linalg.inv(T_w_l)
    T_w_l[:3, 3] = T_w_c[:3, 3] + SHADOW_AHEAD_M * T_w_c[:3, 2]
    scale = np.diag([1.0 / SHADOW_HALF_M, 1.0 / SHADOW_HALF_M, 1.0 / SHADOW_DEPTH_M, 1.0])
    return scale @ np.linalg.inv(T_w_l)
