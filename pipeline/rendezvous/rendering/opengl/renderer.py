"""Scenes to pictures and to what each pixel shows. The only file that knows OpenGL's axes.

pyrender opens the context; the passes are our own. Its renderer draws node by node and shades what is hidden,
too: 150 boxes and a robot of 20,000 triangles took it 177 ms of one core at 640x480 for colour and
segmentation (288 ms with one shadow); here they take 65 ms (73 ms). And the order of its sets of nodes and
lights, which rounding shows in the picture, changes between processes. Here meshes and textures are uploaded
once, one call draws all instances of a mesh, in the order of the pool and the scene, and nothing is rebuilt.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import trimesh
from numpy.typing import NDArray

from rendezvous.errors import PipelineError
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
    Scene,
    TexturePool,
)
from rendezvous.rendering.visibility import RobotView, robot_view

if TYPE_CHECKING:
    from rendezvous.rendering.opengl.passes import Draw, LightTable
    from rendezvous.rendering.opengl.resident import Float32

NEAR_M, FAR_M = 0.02, 60.0
"""What is nearer or farther than this from the camera is not drawn."""

SHADOW_AHEAD_M, SHADOW_HALF_M = 2.2, 3.2
"""Shadows of parallel light are computed in a box of this half width, centred this far before the camera."""

SHADOW_DEPTH_M = 20.0

CANVAS_MARGIN = 2
"""A silhouette is counted this many images beyond the image, to every side."""

CREASE = 2e-6
"""Second difference of the buffer's depth from which a pixel is a crease; its steps are 6e-8."""

ROW_FLOATS = 4 * ROW_TEXELS

Row = tuple[float, ...]


class Renderer:
    """Renders scenes of one image size from pools of meshes and textures that stay resident.

    One for each process: what it has uploaded stays until the process ends.
    """

    def __init__(
        self, meshes: MeshPool, textures: TexturePool, *, width_px: int = 640, height_px: int = 480
    ) -> None:
        """Upload the pools.

        Raises:
            SetupError: a system library is missing, or no device can be opened.
        """
        headless_context()
        # Not before: PyOpenGL binds itself to a platform, and fails without libraries, when imported.
        from rendezvous.rendering.opengl.passes import Passes
        from rendezvous.rendering.opengl.resident import ResidentPools

        self._width_px, self._height_px = width_px, height_px
        self._pools = ResidentPools(meshes, textures)
        self._corners = {
            key: np.concatenate([trimesh.bounds.corners(part.bounds) for part in parts])
            for key, parts in meshes.items()
        }
        self._passes = Passes(width_px=width_px, height_px=height_px, texture_array=self._pools.texture_array)

    def render(self, scene: Scene) -> Rendering:
        """The picture of a scene.

        Raises:
            PipelineError: the camera's size is not the renderer's, or a mesh or texture is in no pool.
        """
        camera = scene.camera
        if (camera.width_px, camera.height_px) != (self._width_px, self._height_px):
            raise PipelineError(
                f"scene: camera of {camera.width_px}x{camera.height_px} px; this renderer draws "
                f"{self._width_px}x{self._height_px} px"
            )
        draws = self._upload(range(len(scene.instances)), scene.instances)
        T_clip_w = clip_matrix(camera) @ np.linalg.inv(scene.T_w_c)
        size = {"width_px": camera.width_px, "height_px": camera.height_px}
        ids = self._passes.ids(draws, T_clip_w, **size)
        depth = self._passes.depth()
        lights = _light_table(scene, self._contact(scene))
        rgba = self._passes.colour(draws, T_clip_w, scene.T_w_c[:3, 3], lights, _edges(ids, depth))
        return Rendering(rgb=_over(rgba, scene.background), instance_ids=ids, depth_m=_metres(depth))

    def silhouette_px(self, scene: Scene) -> int:
        """How many pixels the robot alone covers on a canvas that reaches CANVAS_MARGIN images further.

        The canvas continues the image's own pixels, and only its tiles around the robot are drawn.
        """
        robot = [(i, scene.instances[i]) for i in scene.robot_ids()]
        if not robot:
            return 0
        draws = self._upload([i for i, _ in robot], [instance for _, instance in robot])
        T_c_w = np.asarray(np.linalg.inv(scene.T_w_c), dtype=np.float64)
        x0, y0, x1, y1 = self._extent_px(scene.camera, T_c_w, [instance for _, instance in robot])
        count = 0
        for y in range(y0, y1, self._height_px):
            for x in range(x0, x1, self._width_px):
                width_px, height_px = min(self._width_px, x1 - x), min(self._height_px, y1 - y)
                tile = _tile(scene.camera, x, y, width_px, height_px)
                ids = self._passes.ids(
                    draws, clip_matrix(tile) @ T_c_w, width_px=width_px, height_px=height_px
                )
                count += int(np.count_nonzero(ids != NO_INSTANCE))
        return count

    def robot_view(self, scene: Scene, rendering: Rendering) -> RobotView:
        """What the rendering of this scene shows of its robot."""
        return robot_view(rendering.instance_ids, scene.robot_ids(), silhouette_px=self.silhouette_px(scene))

    def _upload(self, ids: Iterable[int], instances: Iterable[Instance]) -> list[Draw]:
        """Hand over the table of these instances, those of one mesh together, in the order of the pool."""
        from rendezvous.rendering.opengl.passes import Draw

        by_mesh: dict[str, list[tuple[int, Instance]]] = {key: [] for key in self._pools.parts}
        for i, instance in zip(ids, instances, strict=True):
            self._pools.parts_of(instance.mesh)
            by_mesh[instance.mesh].append((i, instance))
        rows: list[Row] = []
        draws: list[Draw] = []
        for key, members in by_mesh.items():
            for part in self._pools.parts_of(key) if members else ():
                draws.append(Draw(part=part, first_row=len(rows), count=len(members)))
                for i, instance in members:
                    material = instance.material or part.material
                    rows.append(_row(i, instance, material, self._pools.layer(material.texture)))
        self._passes.upload(np.array(rows, dtype=np.float32).reshape(-1, ROW_FLOATS))
        return draws

    def _contact(self, scene: Scene) -> Array:
        """(4,) middle of the robot's lower face, and its radius [m]."""
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
        """x0, y0, x1, y1 of whole pixels around the instances' bounding boxes, within the canvas."""
        size = np.array([camera.width_px, camera.height_px])
        low, high = -CANVAS_MARGIN * size, (1 + CANVAS_MARGIN) * size
        corners_w = self._corners_w(instances)
        corners_c = corners_w @ T_c_w[:3, :3].T + T_c_w[:3, 3]
        # What reaches beside the camera has no outline in the plane of the image: all of the canvas then.
        if corners_c[:, 2].min() > NEAR_M:
            uv_px = camera.project(corners_c)
            low = np.maximum(np.floor(uv_px.min(axis=0)), low)
            high = np.minimum(np.ceil(uv_px.max(axis=0)) + 1.0, high)
        return int(low[0]), int(low[1]), int(high[0]), int(high[1])


def clip_matrix(camera: PinholeCamera) -> Array:
    """(4, 4) from camera frame c to clip space, in which row 0 of the image is lowest.

    Pixel centres are whole numbers, so the image's edge lies at -0.5, which clip space has at -1.
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


def _tile(camera: PinholeCamera, x_px: int, y_px: int, width_px: int, height_px: int) -> PinholeCamera:
    """The same camera with an image that starts at another pixel."""
    return replace(
        camera,
        cx_px=camera.cx_px - x_px,
        cy_px=camera.cy_px - y_px,
        width_px=width_px,
        height_px=height_px,
    )


def _edges(ids: NDArray[np.int32], depth: Float32) -> NDArray[np.bool_]:
    """(H, W) pixels at an outline or a crease, where one sample does not tell what the pixel shows.

    The buffer's depth is linear in 1 / z, which a plane has linear across the image: where its second
    difference is not zero, two surfaces meet.
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
    """Depth of the buffer, 0..1, as distance along the camera's axis; inf where nothing is."""
    # In float32: what it loses matters only tens of metres away.
    depth_m = (FAR_M * NEAR_M) / (FAR_M - depth * np.float32(FAR_M - NEAR_M))
    depth_m[depth >= 1.0] = np.inf
    return depth_m


def _over(rgba: Image, background: Image | None) -> Image:
    """The picture before its background."""
    rgb = np.ascontiguousarray(rgba[:, :, :3])
    if background is not None:
        open_ = rgba[:, :, 3] < 255
        through = 1.0 - rgba[open_, 3:] / 255.0
        rgb[open_] = np.round(rgb[open_] + through * background[open_]).astype(np.uint8)
    return rgb


def _row(i: int, instance: Instance, material: Material, layer: int) -> Row:
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


def _light_table(scene: Scene, contact: Array) -> LightTable:
    from rendezvous.rendering.opengl.passes import LightTable

    lights = sorted(scene.lights, key=lambda light: not light.casts_shadow)
    place, direction, colour = [], [], []
    for light in lights:
        directional, spot = light.kind == LightKind.DIRECTIONAL, light.kind == LightKind.SPOT
        place.append((*light.T_w[:3, 3], 0.0 if directional else 1.0))
        direction.append((*-light.T_w[:3, 2], np.cos(light.cone_rad) if spot else -1.0))
        colour.append((*(light.intensity * np.array(light.colour_rgb)), 0.0))
    return LightTable(
        place=np.array(place, dtype=np.float32),
        direction=np.array(direction, dtype=np.float32),
        colour=np.array(colour, dtype=np.float32),
        T_shadow_w=np.array([_shadow_matrix(light, scene.T_w_c) for light in lights if light.casts_shadow]),
        ambient_rgb=np.array(scene.ambient_rgb),
        contact=contact,
    )


def _shadow_matrix(light: Light, T_w_c: Array) -> Array:
    """(4, 4) from w to the clip space of what the light sees."""
    # A light's axes are OpenGL's (y up, shines along -z); with y down and z forward it is a camera of ours.
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
