"""What stays on the graphics side between pictures: the buffers of all meshes, one array of all textures."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
import trimesh
from numpy.typing import NDArray
from OpenGL import GL

from rendezvous.errors import PipelineError
from rendezvous.geometry.camera import Image
from rendezvous.rendering.scene import Material, MeshPool, TexturePool

TEXTURE_PX = 512
"""All textures are brought to this size, so that one array holds them and nothing is bound between draws."""

_ATTRIBUTE_SIZES = (3, 3, 2, 3)

Float32 = NDArray[np.float32]


@dataclass(frozen=True, slots=True, kw_only=True)
class ResidentPart:
    """A part of a mesh: its vertex array, its number of indices, whether it has UVs, its own material."""

    vertex_array: int
    index_count: int
    has_uv: bool
    material: Material


class ResidentPools:
    """Meshes and textures of the pools, uploaded once."""

    def __init__(self, meshes: MeshPool, textures: TexturePool) -> None:
        own_textures: dict[str, Image] = {}
        self.parts: dict[str, tuple[ResidentPart, ...]] = {
            key: tuple(
                _upload_part(part, _own_material(part, f"{key}[{i}]", own_textures))
                for i, part in enumerate(parts)
            )
            for key, parts in meshes.items()
        }
        layers = {**textures, **own_textures}
        self._layers = {key: layer for layer, key in enumerate(layers)}
        self.texture_array = _upload_textures(list(layers.values()))

    def layer(self, texture: str | None) -> int:
        """Layer of a texture in the array; -1 for none."""
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


def _upload_part(part: trimesh.Trimesh, material: Material) -> ResidentPart:
    vertices = _vertex_table(part)
    indices = np.ascontiguousarray(part.faces, dtype=np.uint32)
    vertex_array = GL.glGenVertexArrays(1)
    GL.glBindVertexArray(vertex_array)
    GL.glBindBuffer(GL.GL_ARRAY_BUFFER, GL.glGenBuffers(1))
    GL.glBufferData(GL.GL_ARRAY_BUFFER, vertices.nbytes, vertices, GL.GL_STATIC_DRAW)
    offset = 0
    for location, size in enumerate(_ATTRIBUTE_SIZES):
        GL.glEnableVertexAttribArray(location)
        at = GL.ctypes.c_void_p(4 * offset)
        GL.glVertexAttribPointer(location, size, GL.GL_FLOAT, GL.GL_FALSE, 4 * sum(_ATTRIBUTE_SIZES), at)
        offset += size
    GL.glBindBuffer(GL.GL_ELEMENT_ARRAY_BUFFER, GL.glGenBuffers(1))
    GL.glBufferData(GL.GL_ELEMENT_ARRAY_BUFFER, indices.nbytes, indices, GL.GL_STATIC_DRAW)
    GL.glBindVertexArray(0)
    return ResidentPart(
        vertex_array=int(vertex_array),
        index_count=indices.size,
        has_uv=_uv(part) is not None,
        material=material,
    )


def _vertex_table(part: trimesh.Trimesh) -> Float32:
    """(V, 11): position, normal, UV, linear colour."""
    count = len(part.vertices)
    uv = _uv(part)
    colours = part.visual.vertex_colors if part.visual.kind in ("vertex", "face") else None
    columns = [
        part.vertices,
        part.vertex_normals,
        np.zeros((count, 2)) if uv is None else uv,
        np.ones((count, 3)) if colours is None else (colours[:, :3] / 255.0) ** 2.2,
    ]
    return np.ascontiguousarray(np.hstack(columns), dtype=np.float32)


def _uv(part: trimesh.Trimesh) -> NDArray[np.float64] | None:
    return getattr(part.visual, "uv", None)


def _own_material(part: trimesh.Trimesh, name: str, textures: dict[str, Image]) -> Material:
    """The material a mesh came with; its texture, if any, is added to `textures`."""
    own = getattr(part.visual, "material", None)
    if not isinstance(own, trimesh.visual.material.PBRMaterial):
        plain = (1.0, 1.0, 1.0) if part.visual.kind in ("vertex", "face") else (0.5, 0.5, 0.5)
        return Material(base_colour_rgb=plain)
    factor = np.array([255, 255, 255, 255] if own.baseColorFactor is None else own.baseColorFactor)
    if np.issubdtype(factor.dtype, np.integer):  # trimesh keeps glTF's linear factor as bytes
        factor = factor / 255.0
    if own.baseColorTexture is not None:
        textures[name] = np.asarray(own.baseColorTexture.convert("RGB"))
    return Material(
        base_colour_rgb=(float(factor[0]), float(factor[1]), float(factor[2])),
        metallic=float(1.0 if own.metallicFactor is None else own.metallicFactor),
        roughness=float(1.0 if own.roughnessFactor is None else own.roughnessFactor),
        texture=name if own.baseColorTexture is not None else None,
    )


def _upload_textures(images: Sequence[Image]) -> int:
    """An array texture that the GPU turns from sRGB to linear as it reads; first row = largest v."""
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
