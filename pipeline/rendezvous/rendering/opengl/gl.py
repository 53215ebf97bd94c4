"""The process's only OpenGL context, off-screen by EGL: on the GPU if there is one, else on the CPU.

A context belongs to its process. Child processes must be spawned: forked after any use of GL, they hang.
"""

from __future__ import annotations

import ctypes
import os
from functools import cache
from typing import Any

from rendezvous.errors import SetupError

LIBRARIES = {"libEGL.so.1": "libegl1", "libGL.so.1": "libgl1"}
"""System libraries that rendering needs, and their Debian packages."""


def check_libraries() -> None:
    """Check that the system libraries for rendering are there.

    Raises:
        SetupError: a system library is missing.
    """
    missing = [library for library in LIBRARIES if not _loads(library)]
    if missing:
        raise SetupError(
            f"rendering needs {' and '.join(missing)}, not found on this machine; "
            f"install with: apt-get install {' '.join(LIBRARIES.values())}"
        )


def renderer_name() -> str:
    """Name of the GPU, or llvmpipe for Mesa's renderer on the CPU."""
    headless_context()
    from OpenGL import GL

    return str(GL.glGetString(GL.GL_RENDERER).decode())


@cache
def headless_context() -> Any:
    """The context, created and made current by the first call; it lives as long as the process.

    It is never destroyed: pyrender would close the display's connection with it, and all other contexts.

    Raises:
        SetupError: a system library is missing, or no EGL device can be opened.
    """
    check_libraries()
    # PyOpenGL chooses its platform when imported, Mesa its threads when first called.
    os.environ["PYOPENGL_PLATFORM"] = "egl"
    os.environ["PYGLET_HEADLESS"] = "1"
    # Two workers of one thread each are faster than one of two threads (19.6 against 14 images per second).
    os.environ.setdefault("LP_NUM_THREADS", "1")
    from pyrender.platforms import egl

    reasons = []
    for device in egl.query_devices():
        platform = egl.EGLPlatform(1, 1, device=device)
        try:
            platform.init_context()
        except Exception as error:  # a GPU that is listed but not permitted: try the next device
            reasons.append(f"{device.name}: {type(error).__name__}")
        else:
            return platform
    raise SetupError(
        f"rendering found no EGL device that opens ({'; '.join(reasons) or 'none is listed'}); "
        "install Mesa's with: apt-get install libegl1 libgl1"
    )


def _loads(library: str) -> bool:
    try:
        ctypes.CDLL(library)
    except OSError:
        return False
    return True
