"""The picture that renders are compared with: `python -m tests.rendering.golden` takes on a wanted change."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from rendezvous.rendering.opengl.renderer import Renderer
from rendezvous.rendering.scene import Scene
from tests.rendering.scenes import crowded_scene, pool, textures

GOLDEN = Path(__file__).parent / "golden.png"


def golden_scene() -> Scene:
    """The robot amid boxes, with shadows."""
    return crowded_scene(np.random.default_rng(7), boxes=12)


if __name__ == "__main__":
    drawn = Renderer(pool(), textures())
    cv2.imwrite(str(GOLDEN), drawn.render(golden_scene()).rgb[:, :, ::-1])
