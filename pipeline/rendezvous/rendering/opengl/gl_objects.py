"""Shader programs and what they draw into. Needs a current OpenGL context."""

from __future__ import annotations

import numpy as np
from OpenGL import GL
from OpenGL.GL import shaders as glsl

from rendezvous.geometry.se2 import Array

Size = tuple[int, int]
Uniform = int | Array


class Program:
    """A vertex and a fragment shader, linked; its uniforms are set by name."""

    def __init__(self, vertex: str, fragment: str) -> None:
        self._program = glsl.compileProgram(
            glsl.compileShader(vertex, GL.GL_VERTEX_SHADER),
            glsl.compileShader(fragment, GL.GL_FRAGMENT_SHADER),
            validate=False,  # would fail: all samplers share unit 0 until `use` gives each its own
        )

    def location(self, uniform: str) -> int:
        """Location of a uniform; -1 if the program does not use it."""
        return int(GL.glGetUniformLocation(self._program, uniform))

    def use(self, **uniforms: Uniform) -> None:
        """Make it current and set uniforms: an int, vectors (..., 3) or (..., 4), or, named T_*, matrices.

        Uniforms that the program does not use, and empty arrays, are skipped.
        """
        GL.glUseProgram(self._program)
        for name, value in uniforms.items():
            location = self.location(name)
            if location < 0 or np.size(value) == 0:
                continue
            if isinstance(value, int):
                GL.glUniform1i(location, value)
                continue
            floats = np.ascontiguousarray(value, dtype=np.float32)
            if name.startswith("T_"):
                GL.glUniformMatrix4fv(location, floats.size // 16, GL.GL_TRUE, floats)
            elif floats.shape[-1] == 3:
                GL.glUniform3fv(location, floats.size // 3, floats)
            else:
                GL.glUniform4fv(location, floats.size // 4, floats)


def make_renderbuffer(size: Size, storage: int) -> int:
    """An image of a format, to draw into."""
    renderbuffer = int(GL.glGenRenderbuffers(1))
    GL.glBindRenderbuffer(GL.GL_RENDERBUFFER, renderbuffer)
    GL.glRenderbufferStorage(GL.GL_RENDERBUFFER, storage, *size)
    return renderbuffer


def make_framebuffer(colour: int, depth: int) -> int:
    """A framebuffer of two renderbuffers."""
    framebuffer = int(GL.glGenFramebuffers(1))
    GL.glBindFramebuffer(GL.GL_FRAMEBUFFER, framebuffer)
    for attachment, renderbuffer in ((GL.GL_COLOR_ATTACHMENT0, colour), (GL.GL_DEPTH_ATTACHMENT, depth)):
        GL.glFramebufferRenderbuffer(GL.GL_FRAMEBUFFER, attachment, GL.GL_RENDERBUFFER, renderbuffer)
    assert GL.glCheckFramebufferStatus(GL.GL_FRAMEBUFFER) == GL.GL_FRAMEBUFFER_COMPLETE
    return framebuffer


def make_texture(size: Size, storage: int, layout: int, component: int, **parameters: int) -> int:
    """An empty 2D texture; parameters are named as GL_TEXTURE_* in lower case."""
    texture = int(GL.glGenTextures(1))
    GL.glBindTexture(GL.GL_TEXTURE_2D, texture)
    GL.glTexImage2D(GL.GL_TEXTURE_2D, 0, storage, *size, 0, layout, component, None)
    for name, value in parameters.items():
        GL.glTexParameteri(GL.GL_TEXTURE_2D, getattr(GL, f"GL_TEXTURE_{name.upper()}"), value)
    return texture


def make_mask_texture(size: Size) -> int:
    """A texture of one byte per pixel, without interpolation."""
    nearest = {"min_filter": GL.GL_NEAREST, "mag_filter": GL.GL_NEAREST}
    return make_texture(size, GL.GL_R8, GL.GL_RED, GL.GL_UNSIGNED_BYTE, **nearest)


def make_shadow_map(side_px: int) -> tuple[int, int]:
    """A framebuffer of depth alone and its texture, which reads as lit or not lit."""
    texture = make_texture(
        (side_px, side_px),
        GL.GL_DEPTH_COMPONENT24,
        GL.GL_DEPTH_COMPONENT,
        GL.GL_FLOAT,
        min_filter=GL.GL_LINEAR,
        mag_filter=GL.GL_LINEAR,
        wrap_s=GL.GL_CLAMP_TO_EDGE,
        wrap_t=GL.GL_CLAMP_TO_EDGE,
        compare_mode=GL.GL_COMPARE_REF_TO_TEXTURE,
        compare_func=GL.GL_LEQUAL,
    )
    framebuffer = int(GL.glGenFramebuffers(1))
    GL.glBindFramebuffer(GL.GL_FRAMEBUFFER, framebuffer)
    GL.glFramebufferTexture2D(GL.GL_FRAMEBUFFER, GL.GL_DEPTH_ATTACHMENT, GL.GL_TEXTURE_2D, texture, 0)
    GL.glDrawBuffer(GL.GL_NONE)
    GL.glReadBuffer(GL.GL_NONE)
    return framebuffer, texture
