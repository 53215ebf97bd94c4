"""MuJoCo without its renderer: physics needs no OpenGL, whatever `MUJOCO_GL` asks for.

`import mujoco` loads the library that `MUJOCO_GL` names and fails where that is missing or unknown.
"""

from __future__ import annotations

import os

_GIVEN = os.environ.get("MUJOCO_GL")
os.environ["MUJOCO_GL"] = "disable"
try:
    import mujoco
finally:
    del os.environ["MUJOCO_GL"]
    if _GIVEN is not None:
        os.environ["MUJOCO_GL"] = _GIVEN

__all__ = ["mujoco"]
