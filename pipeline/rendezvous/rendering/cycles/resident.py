"""Resident in Blender between pictures: all meshes, and the textures that were used."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import trimesh
from numpy.typing import NDArray

from rendezvous.errors import PipelineError
from rendezvous.geometry.camera import Image
from rendezvous.geometry.se2 import Array
from rendezvous.rendering.cycles.blender import blender
from rendezvous.rendering.robot_model import part_material
from rendezvous.rendering.scene import Material, MeshPool, TexturePool

TINT, ALONG, UV = "tint", "along", "uv"
"""Attributes of a mesh: linear colour of a vertex; axis (one of x, y, z is 1) that a face's normal is nearest
to, by which a mesh without UVs is textured; UVs."""


@dataclass(frozen=True, slots=True, kw_only=True)
class BlenderPart:
    """A part of a mesh.

    Attributes:
        mesh: Blender's, with one slot for the material of each of its objects.
        material: its own.
        has_uv, has_tint: whether it has these attributes.
        open: whether it has an edge, so that it can be seen from behind, where it is invisible.
        sheet: whether it is a plane that faces z.
    """

    mesh: Any
    material: Material
    has_uv: bool
    has_tint: bool
    open: bool
    sheet: bool


class BlenderPools:
    """Meshes of the pools, handed over once, and textures, each from its first use on."""

    def __init__(self, meshes: MeshPool, textures: TexturePool) -> None:
        self._textures = dict(textures)
        self._images: dict[str, Any] = {}
        self._parts = {
            key: tuple(self._part(part, f"{key}[{i}]") for i, part in enumerate(parts))
            for key, parts in meshes.items()
        }

    def parts_of(self, mesh: str) -> tuple[BlenderPart, ...]:
        """The parts of a mesh of the pool.

        Raises:
            PipelineError: it is not there.
        """
        if mesh not in self._parts:
            raise PipelineError(f"no mesh {mesh!r} in the pool: {', '.join(self._parts)}")
        return self._parts[mesh]

    def image(self, texture: str) -> Any:
        """A texture of the pool, or a part's own.

        Raises:
            PipelineError: it is not there.
        """
        if texture not in self._textures:
            raise PipelineError(f"no texture {texture!r} in the pool of {len(self._textures)} textures")
        if texture not in self._images:
            self._images[texture] = _image(texture, self._textures[texture])
        return self._images[texture]

    def _part(self, part: trimesh.Trimesh, name: str) -> BlenderPart:
        """Hand a part over; the texture of its own material, if any, joins the textures under the name."""
        uv = getattr(part.visual, "uv", None)
        tint = part.visual.vertex_colors if part.visual.kind in ("vertex", "face") else None
        material = part_material(part)
        picture = getattr(getattr(part.visual, "material", None), "baseColorTexture", None)
        if picture is not None:
            self._textures[name] = np.asarray(picture.convert("RGB"))
            material = replace(material, texture=name)
        # Where edges are sharp, faces share no vertices: only once merged, a closed surface shows as one.
        merged = trimesh.Trimesh(vertices=part.vertices, faces=part.faces)
        merged.merge_vertices(merge_tex=True, merge_norm=True)
        _, front = np.unique(np.sort(merged.faces, axis=1), axis=0, return_index=True)
        return BlenderPart(
            mesh=_mesh(name, part, np.sort(front), uv, tint),
            material=material,
            has_uv=uv is not None,
            has_tint=tint is not None,
            open=len(front) == len(part.faces) and not merged.is_watertight,
            sheet=bool(np.ptp(part.vertices[:, 2]) == 0.0),
        )


def _mesh(
    name: str, part: trimesh.Trimesh, front: NDArray[np.int64], uv: Array | None, tint: Image | None
) -> Any:
    """A part in Blender.

    Args:
        name: its name.
        part: the part.
        front: (F,) numbers of its faces without those that are another's back: of two surfaces in one place,
            a ray of light may meet either.
        uv: (V, 2) UVs.
        tint: (V, 4) colours, sRGB.
    """
    faces = part.faces[front]
    mesh = blender().data.meshes.new(name)
    mesh.from_pydata(part.vertices.tolist(), [], faces.tolist())
    mesh.shade_smooth()
    mesh.normals_split_custom_set_from_vertices(part.vertex_normals.tolist())
    along = np.eye(3, dtype=np.float32)[np.abs(part.face_normals[front]).argmax(axis=1)]
    mesh.attributes.new(ALONG, "FLOAT_VECTOR", "FACE").data.foreach_set("vector", along.ravel())
    if uv is not None:
        corners = np.asarray(uv, dtype=np.float32)[faces.ravel()]
        mesh.uv_layers.new(name=UV).uv.foreach_set("vector", corners.ravel())
    if tint is not None:
        linear = np.ones((len(part.vertices), 4), dtype=np.float32)
        linear[:, :3] = (tint[:, :3] / 255.0) ** 2.2
        mesh.attributes.new(TINT, "FLOAT_COLOR", "POINT").data.foreach_set("color", linear.ravel())
    mesh.materials.append(None)
    return mesh


def _image(name: str, pixels: Image) -> Any:
    """A texture whose first row has the largest v."""
    height_px, width_px = pixels.shape[:2]
    image = blender().data.images.new(name, width_px, height_px)
    rgba = np.ones((height_px, width_px, 4), dtype=np.float32)
    rgba[..., :3] = pixels[::-1] / 255.0
    image.pixels.foreach_set(rgba.ravel())
    image.update()
    return image
