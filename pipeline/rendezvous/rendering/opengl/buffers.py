"""What the passes draw with and into: programs, framebuffers, textures. Needs a context current."""

from __future__ import annotations

from OpenGL import GL
from OpenGL.GL import shaders as glsl

from rendezvous.rendering.opengl.shaders import SHADOW_PX

Size = tuple[int, int]


def make_program(vertex: str, fragment: str) -> int:
    """A vertex and a fragment shader, compiled and linked."""
    program = glsl.compileProgram(
        glsl.compileShader(vertex, GL.GL_VERTEX_SHADER),
        glsl.compileShader(fragment, GL.GL_FRAGMENT_SHADER),
        validate=False,  # it could not be drawn with yet: its samplers share a unit until they get their own
    )
    return int(program)


def make_renderbuffer(size: Size, storage: int) -> int:
    """Memory for an image of this format."""
    renderbuffer = int(GL.glGenRenderbuffers(1))
    GL.glBindRenderbuffer(GL.GL_RENDERBUFFER, renderbuffer)
    GL.glRenderbufferStorage(GL.GL_RENDERBUFFER, storage, *size)
    return renderbuffer


def make_framebuffer(colour: int, depth: int) -> int:
    """What draws into two renderbuffers."""
    framebuffer = int(GL.glGenFramebuffers(1))
    GL.glBindFramebuffer(GL.GL_FRAMEBUFFER, framebuffer)
    for attachment, renderbuffer in (
        (GL.GL_COLOR_ATTACHMENT0, colour),
        (GL.GL_DEPTH_ATTACHMENT, depth),
    ):
        GL.glFramebufferRenderbuffer(GL.GL_FRAMEBUFFER, attachment, GL.GL_RENDERBUFFER, renderbuffer)
    assert GL.glCheckFramebufferStatus(GL.GL_FRAMEBUFFER) == GL.GL_FRAMEBUFFER_COMPLETE
    return framebuffer


def make_mask_texture(size: Size) -> int:
    """A texture of one byte a pixel, read pixel by pixel."""
    texture = int(GL.glGenTextures(1))
    GL.glBindTexture(GL.GL_TEXTURE_2D, texture)
    GL.glTexImage2D(GL.GL_TEXTURE_2D, 0, GL.GL_R8, *size, 0, GL.GL_RED, GL.GL_UNSIGNED_BYTE, None)
    for name in (GL.GL_TEXTURE_MIN_FILTER, GL.GL_TEXTURE_MAG_FILTER):
        GL.glTexParameteri(GL.GL_TEXTURE_2D, name, GL.GL_NEAREST)
    return texture


def make_shadow_map() -> tuple[int, int]:
    """A framebuffer of depth alone, and the texture it draws to, read as lit or not."""
    texture, side = int(GL.glGenTextures(1)), SHADOW_PX
    GL.glBindTexture(GL.GL_TEXTURE_2D, texture)
    GL.glTexImage2D(
        GL.GL_TEXTURE_2D, 0, GL.GL_DEPTH_COMPONENT24, side, side, 0, GL.GL_DEPTH_COMPONENT, GL.GL_FLOAT, None
    )
    for name, value in (
        (GL.GL_TEXTURE_MIN_FILTER, GL.GL_LINEAR),
        (GL.GL_TEXTURE_MAG_FILTER, GL.GL_LINEAR),
        (GL.GL_TEXTURE_WRAP_S, GL.GL_CLAMP_TO_EDGE),
        (GL.GL_TEXTURE_WRAP_T, GL.GL_CLAMP_TO_EDGE),
        (GL.GL_TEXTURE_COMPARE_MODE, GL.GL_COMPARE_REF_TO_TEXTURE),
        (GL.GL_TEXTURE_COMPARE_FUNC, GL.GL_LEQUAL),
    ):
        GL.glTexParameteri(GL.GL_TEXTURE_2D, name, value)
    framebuffer = int(GL.glGenFramebuffers(1))
    GL.glBindFramebuffer(GL.GL_FRAMEBUFFER, framebuffer)
    GL.glFramebufferTexture2D(GL.GL_FRAMEBUFFER, GL.GL_DEPTH_ATTACHMENT, GL.GL_TEXTURE_2D, texture, 0)
    GL.glDrawBuffer(GL.GL_NONE)
    GL.glReadBuffer(GL.GL_NONE)
    return framebuffer, texture
