"""The passes over a scene: ids and depth, shadows, colour.

Importing this needs the libraries of `gl.LIBRARIES` and a current context; `renderer.Renderer` sees to both.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from OpenGL import GL

from rendezvous.geometry.camera import Image
from rendezvous.geometry.occupancy_grid import Mask
from rendezvous.geometry.se2 import Array
from rendezvous.rendering.opengl import shaders
from rendezvous.rendering.opengl.gl_objects import (
    Program,
    Size,
    Uniform,
    make_framebuffer,
    make_mask_texture,
    make_renderbuffer,
    make_shadow_map,
)
from rendezvous.rendering.opengl.resident import Float32, ResidentPart
from rendezvous.rendering.scene import MAX_SHADOWS, NO_INSTANCE

INSTANCES_UNIT, TEXTURES_UNIT, SHADOW_UNIT, MASK_UNIT = 0, 1, 2, 2 + MAX_SHADOWS
"""Texture units, the first of several for shadows."""


@dataclass(frozen=True, slots=True, kw_only=True)
class DrawCall:
    """A part of a mesh, drawn once for each of `count` rows of the table of instances."""

    part: ResidentPart
    first_row: int
    count: int


class Passes:
    """Programs and framebuffers for one image size."""

    def __init__(self, *, width_px: int, height_px: int, vertex_array: int, texture_array: int) -> None:
        self._size = (width_px, height_px)
        self._vertex_array = vertex_array
        self._id_program = Program(shaders.ID_VERTEX, shaders.ID_FRAGMENT)
        self._depth_program = Program(shaders.ID_VERTEX, shaders.DEPTH_FRAGMENT)
        self._mask_program = Program(shaders.MASK_VERTEX, shaders.MASK_FRAGMENT)
        self._surface_programs = [
            Program(shaders.SURFACE_VERTEX, shaders.surface_fragment(shadows=shadows))
            for shadows in range(MAX_SHADOWS + 1)
        ]
        depth = make_renderbuffer(self._size, GL.GL_DEPTH_COMPONENT24)
        self._id_buffer = make_framebuffer(make_renderbuffer(self._size, GL.GL_R32I), depth)
        self._colour_buffer = make_framebuffer(make_renderbuffer(self._size, GL.GL_RGBA8), depth)
        self._fine_size = (shaders.EDGE_SAMPLES * width_px, shaders.EDGE_SAMPLES * height_px)
        self._fine_buffer = make_framebuffer(
            make_renderbuffer(self._fine_size, GL.GL_RGBA8),
            make_renderbuffer(self._fine_size, GL.GL_DEPTH_COMPONENT24),
        )
        self._shadow_maps = [make_shadow_map(shaders.SHADOW_PX) for _ in range(MAX_SHADOWS)]
        shadows = [(GL.GL_TEXTURE_2D, texture) for _, texture in self._shadow_maps]
        mask = (GL.GL_TEXTURE_2D, make_mask_texture(self._size))
        self._textures = [(GL.GL_TEXTURE_2D_ARRAY, texture_array), *shadows, mask]
        self._empty_array = GL.glGenVertexArrays(1)
        self._rows_buffer = GL.glGenBuffers(1)
        self._rows_texture = GL.glGenTextures(1)
        self._commands_buffer = GL.glGenBuffers(1)
        self._command_count = 0

    def upload(self, draws: Sequence[DrawCall], rows: Float32) -> None:
        """What the next passes draw: (N, 4 ROW_TEXELS) rows are the table of instances."""
        commands = np.array(
            [
                (d.part.index_count, d.count, d.part.first_index, d.part.first_vertex, d.first_row)
                for d in draws
            ],
            dtype=np.uint32,
        )
        self._command_count = len(draws)
        GL.glBindBuffer(GL.GL_DRAW_INDIRECT_BUFFER, self._commands_buffer)
        GL.glBufferData(GL.GL_DRAW_INDIRECT_BUFFER, commands.nbytes, commands, GL.GL_STREAM_DRAW)
        GL.glBindBuffer(GL.GL_TEXTURE_BUFFER, self._rows_buffer)
        GL.glBufferData(GL.GL_TEXTURE_BUFFER, rows.nbytes, rows, GL.GL_STREAM_DRAW)
        GL.glActiveTexture(GL.GL_TEXTURE0 + INSTANCES_UNIT)
        GL.glBindTexture(GL.GL_TEXTURE_BUFFER, self._rows_texture)
        GL.glTexBuffer(GL.GL_TEXTURE_BUFFER, GL.GL_RGBA32F, self._rows_buffer)

    def ids(self, T_clip_w: Array, *, width_px: int, height_px: int) -> NDArray[np.int32]:
        """(H, W) id of the nearest instance, in the corner of the buffer for which the matrix is made."""
        _target(self._id_buffer, (width_px, height_px))
        GL.glClearBufferiv(GL.GL_COLOR, 0, np.full(4, NO_INSTANCE, dtype=np.int32))
        GL.glClear(GL.GL_DEPTH_BUFFER_BIT)
        self._draw(self._id_program, T_clip_w)
        pixels = GL.glReadPixels(0, 0, width_px, height_px, GL.GL_RED_INTEGER, GL.GL_INT)
        return np.frombuffer(pixels, dtype=np.int32).reshape(height_px, width_px)

    def depth(self) -> Float32:
        """(H, W) depth of the last `ids`, from 0 (nearest) to 1."""
        width_px, height_px = self._size
        pixels = GL.glReadPixels(0, 0, width_px, height_px, GL.GL_DEPTH_COMPONENT, GL.GL_FLOAT)
        return np.frombuffer(pixels, dtype=np.float32).reshape(height_px, width_px)

    def colour(
        self,
        T_clip_w: Array,
        T_shadow_w: Array,
        light: Mapping[str, Uniform],
        edges: Mask,
    ) -> Image:
        """(H, W, 4) uint8: sRGB and coverage, black where uncovered.

        Uses the depth that `ids` has just left for the same image, so that hidden surfaces are not lit.

        Args:
            T_clip_w: (4, 4) camera.
            T_shadow_w: (S, 4, 4) world to clip space of each light with shadows.
            light: the surface shader's other uniforms.
            edges: (H, W) pixels to compute from several samples. Multisampling all pixels would take four
                times as long on the CPU, where Mesa shades every sample and tests depth last.
        """
        for shadow, (framebuffer, _) in enumerate(self._shadow_maps[: len(T_shadow_w)]):
            _target(framebuffer, (shaders.SHADOW_PX, shaders.SHADOW_PX), clear=GL.GL_DEPTH_BUFFER_BIT)
            GL.glEnable(GL.GL_POLYGON_OFFSET_FILL)
            GL.glPolygonOffset(2.0, 4.0)
            self._draw(self._depth_program, T_shadow_w[shadow])
            GL.glDisable(GL.GL_POLYGON_OFFSET_FILL)
        for unit, (target, texture) in enumerate(self._textures, start=TEXTURES_UNIT):
            GL.glActiveTexture(GL.GL_TEXTURE0 + unit)
            GL.glBindTexture(target, texture)
        program = self._surface_programs[len(T_shadow_w)]
        samplers = {f"shadow_{i}": SHADOW_UNIT + i for i in range(MAX_SHADOWS)}
        program.use(instances=INSTANCES_UNIT, textures=TEXTURES_UNIT, **samplers)
        program.use(T_shadow_w=T_shadow_w, **light)

        GL.glClearColor(0.0, 0.0, 0.0, 0.0)
        _target(self._colour_buffer, self._size, clear=GL.GL_COLOR_BUFFER_BIT)
        GL.glDepthFunc(GL.GL_LEQUAL)
        self._draw(program, T_clip_w)
        rgba = self._read_colour()

        _target(self._fine_buffer, self._fine_size, clear=GL.GL_COLOR_BUFFER_BIT | GL.GL_DEPTH_BUFFER_BIT)
        GL.glColorMask(*4 * [GL.GL_FALSE])
        self._hide_all_but(edges)
        self._draw(self._depth_program, T_clip_w)
        GL.glColorMask(*4 * [GL.GL_TRUE])
        GL.glDepthFunc(GL.GL_LEQUAL)
        self._draw(program, T_clip_w)
        GL.glBindFramebuffer(GL.GL_READ_FRAMEBUFFER, self._fine_buffer)
        GL.glBindFramebuffer(GL.GL_DRAW_FRAMEBUFFER, self._colour_buffer)
        # Halved with linear interpolation, each pixel is the mean of its four samples.
        GL.glBlitFramebuffer(0, 0, *self._fine_size, 0, 0, *self._size, GL.GL_COLOR_BUFFER_BIT, GL.GL_LINEAR)
        rgba[edges] = self._read_colour()[edges]
        return rgba

    def _hide_all_but(self, edges: Mask) -> None:
        """Set the depth to the nearest wherever nothing is to be drawn."""
        GL.glActiveTexture(GL.GL_TEXTURE0 + MASK_UNIT)
        GL.glPixelStorei(GL.GL_UNPACK_ALIGNMENT, 1)
        pixels = edges.astype(np.uint8) * 255
        GL.glTexSubImage2D(GL.GL_TEXTURE_2D, 0, 0, 0, *self._size, GL.GL_RED, GL.GL_UNSIGNED_BYTE, pixels)
        self._mask_program.use(mask=MASK_UNIT)
        GL.glDisable(GL.GL_CULL_FACE)
        GL.glBindVertexArray(self._empty_array)
        GL.glDrawArrays(GL.GL_TRIANGLES, 0, 3)

    def _draw(self, program: Program, T_clip_w: Array) -> None:
        """Draw all that was uploaded, by one call: calls took a fifth of the time."""
        program.use(T_clip_w=T_clip_w)
        GL.glEnable(GL.GL_DEPTH_TEST)
        GL.glEnable(GL.GL_CULL_FACE)
        # Row 0 of our images is at the top, of GL's at the bottom: GL sees everything upside down.
        GL.glFrontFace(GL.GL_CW)
        GL.glBindVertexArray(self._vertex_array)
        GL.glBindBuffer(GL.GL_DRAW_INDIRECT_BUFFER, self._commands_buffer)
        GL.glMultiDrawElementsIndirect(GL.GL_TRIANGLES, GL.GL_UNSIGNED_INT, None, self._command_count, 0)
        GL.glBindVertexArray(0)
        GL.glDepthFunc(GL.GL_LESS)

    def _read_colour(self) -> Image:
        width_px, height_px = self._size
        rgba = np.empty((height_px, width_px, 4), dtype=np.uint8)
        GL.glBindFramebuffer(GL.GL_READ_FRAMEBUFFER, self._colour_buffer)
        GL.glReadPixels(0, 0, width_px, height_px, GL.GL_RGBA, GL.GL_UNSIGNED_BYTE, rgba)
        return rgba


def _target(framebuffer: int, size: Size, *, clear: int = 0) -> None:
    """Draw into this framebuffer from now on, after clearing these of its buffers."""
    GL.glBindFramebuffer(GL.GL_FRAMEBUFFER, framebuffer)
    GL.glViewport(0, 0, *size)
    GL.glClear(clear)
