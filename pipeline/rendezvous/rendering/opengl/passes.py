"""The passes over a scene on the graphics side: ids and depth, shadows, colour.

Importing this needs the libraries of `gl.LIBRARIES`, and a context current: `renderer.Renderer` sees to it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from OpenGL import GL

from rendezvous.geometry.camera import Image
from rendezvous.geometry.se2 import Array
from rendezvous.rendering.opengl import shaders
from rendezvous.rendering.opengl.buffers import (
    make_framebuffer,
    make_mask_texture,
    make_program,
    make_renderbuffer,
    make_shadow_map,
)
from rendezvous.rendering.opengl.resident import Float32, ResidentPart
from rendezvous.rendering.scene import MAX_SHADOWS, NO_INSTANCE

MASK_UNIT = 4

Mask = NDArray[np.bool_]


@dataclass(frozen=True, slots=True, kw_only=True)
class Draw:
    """One part of a mesh, drawn at the places of `count` rows of the table of instances."""

    part: ResidentPart
    first_row: int
    count: int


@dataclass(frozen=True, slots=True, kw_only=True)
class LightTable:
    """The lights as the shader reads them, and the world-to-clip matrices of those that throw shadows.

    Attributes:
        place, direction, colour: (L, 4) float32, see the shader; those that throw shadows first.
        T_shadow_w: (S, 4, 4).
        ambient_rgb: (3,).
        contact: (4,) place and radius [m] of what darkens the ground below it; radius 0 for nothing.
    """

    place: Float32
    direction: Float32
    colour: Float32
    T_shadow_w: Array
    ambient_rgb: Array
    contact: Array


class Passes:
    """Programs and framebuffers of one image size."""

    def __init__(self, *, width_px: int, height_px: int, texture_array: int) -> None:
        self._size = (width_px, height_px)
        self._texture_array = texture_array
        self._id_program = make_program(shaders.ID_VERTEX, shaders.ID_FRAGMENT)
        self._depth_program = make_program(shaders.ID_VERTEX, shaders.DEPTH_FRAGMENT)
        self._mask_program = make_program(shaders.MASK_VERTEX, shaders.MASK_FRAGMENT)
        self._surface_programs = [
            make_program(shaders.SURFACE_VERTEX, shaders.surface_fragment(shadows=shadows))
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
        self._mask_texture = make_mask_texture(self._size)
        self._empty_array = GL.glGenVertexArrays(1)
        self._shadow_maps = [make_shadow_map() for _ in range(MAX_SHADOWS)]
        self._rows_buffer = GL.glGenBuffers(1)
        self._rows_texture = GL.glGenTextures(1)

    def upload(self, rows: Float32) -> None:
        """Make (N, 4 ROW_TEXELS) rows the table of instances that the next passes read."""
        GL.glBindBuffer(GL.GL_TEXTURE_BUFFER, self._rows_buffer)
        GL.glBufferData(GL.GL_TEXTURE_BUFFER, rows.nbytes, rows, GL.GL_STREAM_DRAW)
        GL.glActiveTexture(GL.GL_TEXTURE0)
        GL.glBindTexture(GL.GL_TEXTURE_BUFFER, self._rows_texture)
        GL.glTexBuffer(GL.GL_TEXTURE_BUFFER, GL.GL_RGBA32F, self._rows_buffer)

    def ids(
        self, draws: Sequence[Draw], T_clip_w: Array, *, width_px: int, height_px: int
    ) -> NDArray[np.int32]:
        """(H, W) id of what is nearest, in the corner of the buffer that the matrix is made for."""
        self._draw_ids(draws, T_clip_w, width_px, height_px)
        pixels = GL.glReadPixels(0, 0, width_px, height_px, GL.GL_RED_INTEGER, GL.GL_INT)
        return np.frombuffer(pixels, dtype=np.int32).reshape(height_px, width_px)

    def depth(self) -> Float32:
        """(H, W) depth 0..1 of what the last `ids` drew, nearest at 0."""
        width_px, height_px = self._size
        pixels = GL.glReadPixels(0, 0, width_px, height_px, GL.GL_DEPTH_COMPONENT, GL.GL_FLOAT)
        return np.frombuffer(pixels, dtype=np.float32).reshape(height_px, width_px)

    def colour(
        self, draws: Sequence[Draw], T_clip_w: Array, p_w_c: Array, lights: LightTable, edges: Mask
    ) -> Image:
        """(H, W, 4) uint8: sRGB and coverage; all that is uncovered is black.

        It needs the depth that `ids` has just left for the same image: the light of a pixel is then computed
        once, not for everything behind it too.

        Args:
            draws: what to draw.
            T_clip_w: (4, 4) camera.
            p_w_c: (3,) its place.
            lights: what lights it.
            edges: (H, W) pixels to compute from several samples. All pixels of a multisampled buffer would
                take four times as long on the CPU, where Mesa shades every sample and tests depth last.
        """
        for shadow_map, T_shadow_w in zip(self._shadow_maps, lights.T_shadow_w, strict=False):
            self._draw_shadow(draws, shadow_map, T_shadow_w)
        program = self._surface_programs[len(lights.T_shadow_w)]
        self._bind_surface(program, p_w_c, lights)
        GL.glClearColor(0.0, 0.0, 0.0, 0.0)
        GL.glBindFramebuffer(GL.GL_FRAMEBUFFER, self._colour_buffer)
        GL.glViewport(0, 0, *self._size)
        GL.glClear(GL.GL_COLOR_BUFFER_BIT)
        GL.glDepthFunc(GL.GL_LEQUAL)
        self._draw(program, draws, T_clip_w)
        rgba = self._read_colour()
        GL.glBindFramebuffer(GL.GL_FRAMEBUFFER, self._fine_buffer)
        GL.glViewport(0, 0, *self._fine_size)
        GL.glClear(GL.GL_COLOR_BUFFER_BIT | GL.GL_DEPTH_BUFFER_BIT)
        self._hide_all_but(edges)
        self._draw(self._depth_program, draws, T_clip_w)
        GL.glColorMask(*4 * [GL.GL_TRUE])
        GL.glDepthFunc(GL.GL_LEQUAL)
        self._draw(program, draws, T_clip_w)
        self._average()
        rgba[edges] = self._read_colour()[edges]
        return rgba

    def _hide_all_but(self, edges: Mask) -> None:
        """Put the nearest depth wherever nothing is to be drawn, and leave colours shut."""
        GL.glActiveTexture(GL.GL_TEXTURE0 + MASK_UNIT)
        GL.glBindTexture(GL.GL_TEXTURE_2D, self._mask_texture)
        GL.glPixelStorei(GL.GL_UNPACK_ALIGNMENT, 1)
        GL.glTexSubImage2D(
            GL.GL_TEXTURE_2D,
            0,
            0,
            0,
            *self._size,
            GL.GL_RED,
            GL.GL_UNSIGNED_BYTE,
            edges.astype(np.uint8) * 255,
        )
        GL.glActiveTexture(GL.GL_TEXTURE0)
        GL.glUseProgram(self._mask_program)
        GL.glUniform1i(GL.glGetUniformLocation(self._mask_program, "mask"), MASK_UNIT)
        GL.glColorMask(*4 * [GL.GL_FALSE])
        GL.glDisable(GL.GL_CULL_FACE)
        GL.glBindVertexArray(self._empty_array)
        GL.glDrawArrays(GL.GL_TRIANGLES, 0, 3)

    def _draw_ids(self, draws: Sequence[Draw], T_clip_w: Array, width_px: int, height_px: int) -> None:
        GL.glBindFramebuffer(GL.GL_FRAMEBUFFER, self._id_buffer)
        GL.glViewport(0, 0, width_px, height_px)
        GL.glClearBufferiv(GL.GL_COLOR, 0, np.full(4, NO_INSTANCE, dtype=np.int32))
        GL.glClear(GL.GL_DEPTH_BUFFER_BIT)
        self._draw(self._id_program, draws, T_clip_w)

    def _draw_shadow(self, draws: Sequence[Draw], shadow_map: tuple[int, int], T_shadow_w: Array) -> None:
        GL.glBindFramebuffer(GL.GL_FRAMEBUFFER, shadow_map[0])
        GL.glViewport(0, 0, shaders.SHADOW_PX, shaders.SHADOW_PX)
        GL.glClear(GL.GL_DEPTH_BUFFER_BIT)
        GL.glEnable(GL.GL_POLYGON_OFFSET_FILL)
        GL.glPolygonOffset(2.0, 4.0)
        self._draw(self._depth_program, draws, T_shadow_w)
        GL.glDisable(GL.GL_POLYGON_OFFSET_FILL)

    def _draw(self, program: int, draws: Sequence[Draw], T_clip_w: Array) -> None:
        GL.glUseProgram(program)
        GL.glEnable(GL.GL_DEPTH_TEST)
        GL.glEnable(GL.GL_CULL_FACE)
        # Row 0 of our images is at the top, of GL's at the bottom: seen from GL, all is upside down.
        GL.glFrontFace(GL.GL_CW)
        matrix = T_clip_w.astype(np.float32)
        GL.glUniformMatrix4fv(GL.glGetUniformLocation(program, "T_clip_w"), 1, GL.GL_TRUE, matrix)
        first_row, own_uv = (GL.glGetUniformLocation(program, name) for name in ("first_row", "own_uv"))
        for draw in draws:
            GL.glUniform1i(first_row, draw.first_row)
            if own_uv >= 0:  # the other programs have no textures
                GL.glUniform1i(own_uv, draw.part.has_uv)
            GL.glBindVertexArray(draw.part.vertex_array)
            GL.glDrawElementsInstanced(
                GL.GL_TRIANGLES, draw.part.index_count, GL.GL_UNSIGNED_INT, None, draw.count
            )
        GL.glBindVertexArray(0)
        GL.glDepthFunc(GL.GL_LESS)

    def _bind_surface(self, program: int, p_w_c: Array, lights: LightTable) -> None:
        """Textures in units 1 to 3, and what the light is computed from."""
        units = [(GL.GL_TEXTURE_2D_ARRAY, self._texture_array)]
        units += [(GL.GL_TEXTURE_2D, texture) for _, texture in self._shadow_maps]
        for unit, (target, texture) in enumerate(units, start=1):
            GL.glActiveTexture(GL.GL_TEXTURE0 + unit)
            GL.glBindTexture(target, texture)
        GL.glActiveTexture(GL.GL_TEXTURE0)

        GL.glUseProgram(program)
        for unit, name in enumerate(("instances", "textures", "shadow_0", "shadow_1")):
            GL.glUniform1i(GL.glGetUniformLocation(program, name), unit)
        GL.glUniform3f(GL.glGetUniformLocation(program, "camera_w"), *p_w_c)
        GL.glUniform3f(GL.glGetUniformLocation(program, "ambient"), *lights.ambient_rgb)
        GL.glUniform4f(GL.glGetUniformLocation(program, "contact"), *lights.contact)
        GL.glUniform1i(GL.glGetUniformLocation(program, "light_count"), len(lights.place))
        for name in ("place", "direction", "colour"):
            values = getattr(lights, name)
            if len(values):
                location = GL.glGetUniformLocation(program, f"light_{name}")
                GL.glUniform4fv(location, len(values), values)
        if len(lights.T_shadow_w):
            matrices = lights.T_shadow_w.astype(np.float32)
            location = GL.glGetUniformLocation(program, "T_shadow_w")
            GL.glUniformMatrix4fv(location, len(matrices), GL.GL_TRUE, matrices)

    def _average(self) -> None:
        """The mean of each pixel's samples, from the fine buffer into the plain one."""
        GL.glBindFramebuffer(GL.GL_READ_FRAMEBUFFER, self._fine_buffer)
        GL.glBindFramebuffer(GL.GL_DRAW_FRAMEBUFFER, self._colour_buffer)
        # Halved, linear interpolation falls on the corner that four samples share.
        GL.glBlitFramebuffer(0, 0, *self._fine_size, 0, 0, *self._size, GL.GL_COLOR_BUFFER_BIT, GL.GL_LINEAR)

    def _read_colour(self) -> Image:
        width_px, height_px = self._size
        rgba = np.empty((height_px, width_px, 4), dtype=np.uint8)
        GL.glBindFramebuffer(GL.GL_READ_FRAMEBUFFER, self._colour_buffer)
        GL.glReadPixels(0, 0, width_px, height_px, GL.GL_RGBA, GL.GL_UNSIGNED_BYTE, rgba)
        return rgba
