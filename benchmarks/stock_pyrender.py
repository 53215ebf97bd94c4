"""The same scenes drawn by pyrender's own renderer: image and segmentation.

It has the easier task: its meshes stay on the device, and it draws no textures, shadows or silhouettes.
"""

from __future__ import annotations

import os
import statistics
import time
from typing import Any

from rendezvous.rendering.opengl.gl import check_libraries
from rendezvous.rendering.scene import LightKind, Scene
from rendezvous.stages.dataset.pictures import RenderJob


def seconds_per_image(setting: RenderJob, scenes: list[Scene]) -> float:
    """Median over scenes without the first third, which uploads meshes."""
    check_libraries()
    os.environ.update(PYOPENGL_PLATFORM="egl", LP_NUM_THREADS="1")
    import pyrender

    camera = scenes[0].camera
    renderer = pyrender.OffscreenRenderer(camera.width_px, camera.height_px)
    pool, times_s = _Pool(setting), []
    for scene in scenes:
        started_s = time.perf_counter()
        drawn, nodes = pool.scene(scene)
        renderer.render(drawn)
        colours = {node: (i % 255 + 1, i // 255, 0) for i, node in enumerate(nodes)}
        renderer.render(drawn, flags=pyrender.RenderFlags.SEG, seg_node_map=colours)
        times_s.append(time.perf_counter() - started_s)
    renderer.delete()
    return statistics.median(times_s[len(times_s) // 3 :])


class _Pool:
    """Meshes by the name of their instance, kept from scene to scene."""

    def __init__(self, setting: RenderJob) -> None:
        from rendezvous.rendering.plan_scene import plan_meshes
        from rendezvous.rendering.robot_family import robot_looks
        from rendezvous.rendering.robot_model import robot_parts
        from rendezvous.rendering.thing_meshes import thing_meshes
        from rendezvous.robot_file import load_robot, load_robot_model

        parts = robot_parts(load_robot_model(setting.robot), source=setting.robot)
        _, robot_meshes = robot_looks(load_robot(setting.robot), parts)
        self._meshes = {**plan_meshes(), **thing_meshes(), **robot_meshes}
        self._kept: dict[tuple[str, str], Any] = {}

    def scene(self, scene: Scene) -> tuple[Any, list[Any]]:
        import numpy as np
        import pyrender

        drawn = pyrender.Scene(ambient_light=scene.ambient_rgb)
        camera = scene.camera
        axes = np.diag([1.0, -1.0, -1.0, 1.0])
        lens = pyrender.IntrinsicsCamera(camera.fx_px, camera.fy_px, camera.cx_px + 0.5, camera.cy_px + 0.5)
        drawn.add(lens, pose=scene.T_w_c @ axes)
        nodes = [drawn.add(self._mesh(i), pose=i.T_w, name=i.name) for i in scene.instances]
        for number, light in enumerate(scene.lights[:4]):
            drawn.add(_light(light), pose=light.T_w, name=f"light {number}")
        return drawn, nodes

    def _mesh(self, instance: Any) -> Any:
        import pyrender

        key = (instance.name, instance.mesh)
        if key not in self._kept:
            self._kept[key] = pyrender.Mesh.from_trimesh(list(self._meshes[instance.mesh]), smooth=False)
        mesh = self._kept[key]
        if instance.material is not None:
            for primitive in mesh.primitives:
                primitive.material = pyrender.MetallicRoughnessMaterial(
                    baseColorFactor=[*instance.material.base_colour_rgb, 1.0],
                    metallicFactor=instance.material.metallic,
                    roughnessFactor=instance.material.roughness,
                )
        return mesh


def _light(light: Any) -> Any:
    import pyrender

    if light.kind is LightKind.DIRECTIONAL:
        return pyrender.DirectionalLight(color=light.colour_rgb, intensity=light.intensity)
    if light.kind is LightKind.SPOT:
        return pyrender.SpotLight(
            color=light.colour_rgb,
            intensity=light.intensity,
            innerConeAngle=0.5 * light.cone_rad,
            outerConeAngle=light.cone_rad,
        )
    return pyrender.PointLight(color=light.colour_rgb, intensity=light.intensity)
