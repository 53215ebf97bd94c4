"""Images with the robot painted over: known to show no robot, and otherwise like the others.

Images without a robot are too few to calibrate on.
"""

from __future__ import annotations

import numpy as np

from rendezvous.geometry.camera import Image
from rendezvous.geometry.se2 import Array


def covered_image(image: Image, box_px: Array) -> Image:
    """A copy of the image in which the surroundings cover a box and a margin of a tenth around it.

    The cover is copied from the left of the box, or from the right where there is more of the image.

    Args:
        image: (H, W, 3).
        box_px: (4,) x0, y0, x1, y1.
    """
    height, width = image.shape[:2]
    x0, y0, x1, y1 = (float(v) for v in box_px)
    margin = 0.1 * max(x1 - x0, y1 - y0) + 2.0
    left, top = max(int(x0 - margin), 0), max(int(y0 - margin), 0)
    right, bottom = min(int(x1 + margin) + 1, width), min(int(y1 + margin) + 1, height)
    size = right - left
    beside = left - 1 - np.arange(size) if left >= width - right else right + np.arange(size)[::-1]
    # Beyond its edges the image is mirrored.
    columns = np.abs(beside)
    columns = np.where(columns < width, columns, 2 * (width - 1) - columns)
    out = image.copy()
    out[top:bottom, left:right] = image[top:bottom, np.clip(columns, 0, width - 1)]
    return out
