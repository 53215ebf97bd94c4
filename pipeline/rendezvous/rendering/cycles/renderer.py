"""Path-traced pictures by Blender's Cycles. Labels stay those of the OpenGL renderer, of the same scene.

Light is what makes these pictures other than rasterised ones: it goes from surface to surface, every lamp has
a size and casts shadows, and gloss mirrors the room. What a lamp itself adds to a surface is the same.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from rendezvous.geometry.camera import Image
from rendezvous.rendering.cycles.blender import blender, without_output
from rendezvous.rendering.cycles.materials import Look, make_material
from rendezvous.rendering.cycles.objects import is_behind, is_ceiling, make_lamp, make_object, set_camera
from rendezvous.rendering.cycles.resident import BlenderPart, BlenderPools
from rendezvous.rendering.scene import Instance, MeshPool, Scene, TexturePool

SKY_GAIN = 3.0
"""Ambient light comes into a room through its ceiling only, not from all directions. By this factor, ten
furnished rooms are as bright in the mean as rasterised ones (0.99; each from 0.71 to 1.19)."""


class CyclesRenderer:
    """Renders scenes from pools of meshes and textures; make one per process."""

    def __init__(self, meshes: MeshPool, textures: TexturePool, *, samples: int) -> None:
        """Start Blender.

        Args:
            meshes: the meshes.
            textures: the textures.
            samples: paths of light through each pixel.

        Raises:
            SetupError: Blender is not installed.
        """
        self._scene = _prepared_scene(samples)
        self._pools = BlenderPools(meshes, textures)

    def render(self, scene: Scene) -> Image:
        """(H, W, 3) uint8, sRGB: the picture of a scene.

        Raises:
            PipelineError: a mesh or texture is not in its pool.
        """
        parts = [
            (instance, part)
            for instance, part in self._parts(scene)
            if not is_behind(instance, part, scene.T_w_c)
        ]
        made = [*self._objects(parts), *(make_lamp(light) for light in scene.lights)]
        for an_object in made:
            self._scene.collection.objects.link(an_object)
        background = self._scene.world.node_tree.nodes["Background"]
        background.inputs["Color"].default_value = (*scene.ambient_rgb, 1.0)
        background.inputs["Strength"].default_value = SKY_GAIN if any(is_ceiling(*p) for p in parts) else 1.0
        set_camera(self._scene, scene.camera, scene.T_w_c)
        rgba = self._rgba()
        _forget(made)
        return _over(rgba, scene.background)

    def _parts(self, scene: Scene) -> Iterator[tuple[Instance, BlenderPart]]:
        for instance in scene.instances:
            for part in self._pools.parts_of(instance.mesh):
                yield instance, part

    def _objects(self, parts: Sequence[tuple[Instance, BlenderPart]]) -> list[Any]:
        """An object for each part of an instance; those that look alike share a material."""
        looks: dict[Look, Any] = {}
        made = []
        for instance, part in parts:
            x, y, z = np.linalg.norm(instance.T_w[:3, :3], axis=0).tolist()
            look = Look.of(part, instance.material or part.material, (x, y, z))
            if look not in looks:
                looks[look] = make_material(look, self._pools)
            made.append(make_object(instance, part, looks[look]))
        return made

    def _rgba(self) -> NDArray[np.uint16]:
        """(H, W, 4): sRGB and coverage, colours as if fully covered."""
        # Blender gives pixels to files only.
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "picture.png"
            self._scene.render.filepath = str(path)
            with without_output():
                blender().ops.render.render(write_still=True)
            bgra = cv2.imdecode(np.fromfile(path, np.uint8), cv2.IMREAD_UNCHANGED)
        assert bgra is not None, "Blender wrote no picture"
        return cv2.cvtColor(bgra, cv2.COLOR_BGRA2RGBA)


def _prepared_scene(samples: int) -> Any:
    """Blender's scene with all settings that pictures share, a camera, and a world of ambient light."""
    bpy = blender()
    scene = bpy.context.scene
    _set_quality(scene, samples)
    render, written = scene.render, scene.render.image_settings
    render.resolution_percentage, render.film_transparent, render.dither_intensity = 100, True, 0.0
    written.file_format, written.color_mode, written.color_depth, written.compression = "PNG", "RGBA", "16", 0
    scene.display_settings.display_device = "sRGB"
    scene.view_settings.view_transform, scene.view_settings.look = "Standard", "None"
    scene.world = bpy.data.worlds.new("ambient")
    scene.world.use_nodes = True
    scene.camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
    scene.collection.objects.link(scene.camera)
    return scene


def _set_quality(scene: Any, samples: int) -> None:
    render, cycles = scene.render, scene.cycles
    render.engine, cycles.device = "CYCLES", "CPU"
    # Workers are processes, and the order of threads would show in the picture.
    render.threads_mode, render.threads = "FIXED", 1
    cycles.seed, cycles.samples = 0, samples
    cycles.use_adaptive_sampling = False  # it pays from some 50 samples on
    cycles.use_light_tree = False  # it pays with many lamps
    cycles.use_denoising, cycles.denoiser, cycles.denoising_prefilter = True, "OPENIMAGEDENOISE", "FAST"
    cycles.max_bounces, cycles.diffuse_bounces, cycles.glossy_bounces = 4, 3, 2
    # Light that gloss throws onto other things would be a few bright specks at so few samples.
    cycles.caustics_reflective = cycles.caustics_refractive = False
    cycles.sample_clamp_indirect = 4.0


def _forget(made: Sequence[Any]) -> None:
    """Remove a picture's objects, lamps and materials; meshes and textures stay."""
    data = blender().data
    lamps = [an_object.data for an_object in made if an_object.type == "LIGHT"]
    data.batch_remove([*made, *lamps, *data.materials])


def _over(rgba: NDArray[np.uint16], background: Image | None) -> Image:
    """(H, W, 3): the picture in front of its background."""
    colour, covered = rgba[..., :3] / 65535.0, rgba[..., 3:] / 65535.0
    behind = 0.0 if background is None else background / 255.0
    return np.round(255.0 * (covered * colour + (1.0 - covered) * behind)).astype(np.uint8)
