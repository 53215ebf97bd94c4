"""Resident on the graphics side between pictures: buffers of all meshes, one array of all textures."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
import trimesh
from numpy.typing import NDArray
from OpenGL import GL

from rendezvous.errors import PipelineError
from rendezvous.geometry.camera import Image
from rendezvous.rendering.robot_model import part_material
from rendezvous.rendering.scene import Material, MeshPool, TexturePool

TEXTURE_PX = 512  # all textures' side: one array holds them, and nothing is bound between draws

_ATTRIBUTE_SIZES = (3, 3, 2, 3, 1)  # position, normal, UV, linear colour, whether it has UVs
ROW_ATTRIBUTE = len(_ATTRIBUTE_SIZES)  # an instance's row in the table of instances
MAX_ROWS = 1 << 16

Float32 = NDArray[np.float32]


@dataclass(frozen=True, slots=True, kw_only=True)
class ResidentPart:
    """A part of a mesh: where it is in the buffers of vertices and indices, and its own material."""

    first_vertex: int
    first_index: int
    index_count: int
    material: Material


class ResidentPools:
    """Meshes and textures of the pools, uploaded once."""

    def __init__(self, meshes: MeshPool, textures: TexturePool) -> None:
        own_textures: dict[str, Image] = {}
        vertices: list[Float32] = []
        indices: list[NDArray[np.uint32]] = []
        self.parts: dict[str, tuple[ResidentPart, ...]] = {}
        first_vertex = first_index = 0
        for key, parts in meshes.items():
            resident = []
            for i, part in enumerate(parts):
                material = _own_material(part, f"{key}[{i}]", own_textures)
                vertices.append(_vertex_table(part))
                indices.append(np.asarray(part.faces, np.uint32).ravel())
                resident.append(
                    ResidentPart(
                        first_vertex=first_vertex,
                        first_index=first_index,
                        index_count=indices[-1].size,
                        material=material,
                    )
                )
                first_vertex, first_index = first_vertex + len(vertices[-1]), first_index + indices[-1].size
            self.parts[key] = tuple(resident)
        self.vertex_array = _upload_vertices(np.concatenate(vertices), np.concatenate(indices))
        layers = {**textures, **own_textures}
        self._layers = {key: layer for layer, key in enumerate(layers)}
        self.texture_array = _upload_textures(list(layers.values()))

    def layer(self, texture: str | None) -> int:
        """Layer of a texture in the array; -1 for None."""
        if texture is None:
            return -1
        if texture not in self._layers:
            raise PipelineError(f"no texture {texture!r} in the pool of {len(self._layers)} textures")
        return self._layers[texture]

    def parts_of(self, mesh: str) -> tuple[ResidentPart, ...]:
        """The parts of a mesh of the pool."""
        if mesh not in self.parts:
            raise PipelineError(f"no mesh {mesh!r} in the pool: {', '.join(self.parts)}")
        return self.parts[mesh]


def _own_material(part: trimesh.Trimesh, name: str, textures: dict[str, Image]) -> Material:
    """The part's own material; the texture of it, if any, is added to `textures` under the name."""
    material = part_material(part)
    picture = getattr(getattr(part.visual, "material", None), "baseColorTexture", None)
    if picture is None:
        return material
    textures[name] = np.asarray(picture.convert("RGB"))
    return replace(material, texture=name)


def _upload_vertices(vertices: Float32, indices: NDArray[np.uint32]) -> int:
    """A vertex array of all meshes, so that one call draws a whole scene."""
    vertex_array = GL.glGenVertexArrays(1)
    GL.glBindVertexArray(vertex_array)
    for target, values in ((GL.GL_ARRAY_BUFFER, vertices), (GL.GL_ELEMENT_ARRAY_BUFFER, indices)):
        GL.glBindBuffer(target, GL.glGenBuffers(1))
        GL.glBufferData(target, values.nbytes, values, GL.GL_STATIC_DRAW)
    for location, size in enumerate(_ATTRIBUTE_SIZES):
        GL.glEnableVertexAttribArray(location)
        at = GL.ctypes.c_void_p(4 * sum(_ATTRIBUTE_SIZES[:location]))
        GL.glVertexAttribPointer(location, size, GL.GL_FLOAT, GL.GL_FALSE, 4 * sum(_ATTRIBUTE_SIZES), at)
    # Row numbers advance by instance, from the first instance that a draw command names.
    rows = np.arange(MAX_ROWS, dtype=np.uint32)
    GL.glBindBuffer(GL.GL_ARRAY_BUFFER, GL.glGenBuffers(1))
    GL.glBufferData(GL.GL_ARRAY_BUFFER, rows.nbytes, rows, GL.GL_STATIC_DRAW)
    GL.glEnableVertexAttribArray(ROW_ATTRIBUTE)
    GL.glVertexAttribIPointer(ROW_ATTRIBUTE, 1, GL.GL_UNSIGNED_INT, 4, GL.ctypes.c_void_p(0))
    GL.glVertexAttribDivisor(ROW_ATTRIBUTE, 1)
    GL.glBindVertexArray(0)
    return int(vertex_array)


def _vertex_table(part: trimesh.Trimesh) -> Float32:
    """(V, 12) attributes of the vertices."""
    uv = getattr(part.visual, "uv", None)
    colours = part.visual.vertex_colors if part.visual.kind in ("vertex", "face") else None
    columns = [
        part.vertices,
        part.vertex_normals,
        np.zeros((len(part.vertices), 2)) if uv is None else uv,
        np.ones((len(part.vertices), 3)) if colours is None else (colours[:, :3] / 255.0) ** 2.2,
        np.full((len(part.vertices), 1), float(uv is not None)),
    ]
    return np.ascontiguousarray(np.hstack(columns), dtype=np.float32)


def _upload_textures(images: Sequence[Image]) -> int:
    """An array texture that reads as linear light; an image's first row has the largest v."""
    texture_array = int(GL.glGenTextures(1))
    GL.glBindTexture(GL.GL_TEXTURE_2D_ARRAY, texture_array)
    layers = max(len(images), 1)
    size = (TEXTURE_PX, TEXTURE_PX)
    GL.glTexImage3D(
        GL.GL_TEXTURE_2D_ARRAY, 0, GL.GL_SRGB8_ALPHA8, *size, layers, 0, GL.GL_RGB, GL.GL_UNSIGNED_BYTE, None
    )
    for layer, image in enumerate(images):
        fitted = image if image.shape[:2] == size else cv2.resize(image, size, interpolation=cv2.INTER_AREA)
        GL.glTexSubImage3D(
            GL.GL_TEXTURE_2D_ARRAY, 0, 0, 0, layer, *size, 1, GL.GL_RGB, GL.GL_UNSIGNED_BYTE,
            np.ascontiguousarray(fitted[::-1]),
        )  # fmt: skip
    GL.glGenerateMipmap(GL.GL_TEXTURE_2D_ARRAY)
    GL.glTexParameteri(GL.GL_TEXTURE_2D_ARRAY, GL.GL_TEXTURE_MIN_FILTER, GL.GL_LINEAR_MIPMAP_LINEAR)
    GL.glTexParameteri(GL.GL_TEXTURE_2D_ARRAY, GL.GL_TEXTURE_MAG_FILTER, GL.GL_LINEAR)
    return texture_array
