"""The process's one OpenGL context, without a screen: EGL, on a GPU where there is one, else on the CPU.

A context is bound to its process: children must be spawned. Forked after any use of GL, they hang.
"""

from __future__ import annotations

import ctypes
import os
from functools import cache
from typing import Any

from rendezvous.errors import SetupError

LIBRARIES = {"libEGL.so.1": "libegl1", "libGL.so.1": "libgl1"}
"""System libraries that rendering needs, and the Debian packages they are in."""


def check_libraries() -> None:
    """Find out whether rendering can work on this machine.

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
    """What draws: the GPU's name, or llvmpipe for Mesa's renderer on the CPU."""
    headless_context()
    from OpenGL import GL

    return str(GL.glGetString(GL.GL_RENDERER).decode())


@cache
def headless_context() -> Any:
    """The context, made at the first call and current from then on; it lives as long as the process.

    Never destroyed: pyrender would end the display's connection, and all other contexts, with it.

    Raises:
        SetupError: a system library is missing, or no EGL device can be opened.
    """
    check_libraries()
    # PyOpenGL picks its platform and Mesa its threads when they are first imported or called.
    os.environ["PYOPENGL_PLATFORM"] = "egl"
    os.environ["PYGLET_HEADLESS"] = "1"
    # One thread for each worker process: two such outdo one with two threads (19.6 to 14 images a second).
    os.environ.setdefault("LP_NUM_THREADS", "1")
    from pyrender.platforms import egl

    reasons = []
    for device in egl.query_devices():
        platform = egl.EGLPlatform(1, 1, device=device)
        try:
            platform.init_context()
        except Exception as error:  # a GPU that is listed but closed to us: the next device may do
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
