"""DOPE's training targets: belief maps of a cuboid's nine points and vector fields towards its centroid.

Definitions follow the training code of NVlabs/Deep_Object_Pose (50x50 maps of a 400x400 image, stride 8). A
point at (u, v) px lies at (u, v) / stride in cells, and cell (row, col) stands for the point (col, row), so a
decoder multiplies by the stride. (The official detector then adds 0.44 cells to undo the shift of its own
upsampling.)

Differences from the official code:

- Maps may have any size and stride; the official ones are square.
- A point behind the camera is NaN and leaves no trace; the official code puts absent points at (-100, -100),
  which leave none either.
- At negative coordinates the official drawing of a vector field's disc rounds towards zero; this rounds down.
- Where discs of several objects overlap, the field is their mean direction; in the official code, with three
  or more objects, it depends on their order.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from rendezvous.geometry.se2 import Array

Maps = NDArray[np.float32]

FIELD_RADIUS_CELLS = 1  # radius of the official vector fields' discs: a vertex's cell and its four neighbours


def belief_maps(uv_px: Array, *, width_px: int, height_px: int, stride_px: int, sigma_cells: float) -> Maps:
    """(9, H, W) float32 in [0, 1]: a Gaussian around each point, the maximum where objects overlap.

    Each Gaussian is cut off 2 sigma from the cell of its point. As in the official code, a point closer than
    that to the border is left out.

    Args:
        uv_px: (N, 9, 2) points of N objects in DOPE's order; NaN for a point behind the camera.
        width_px, height_px: image size; H and W are these divided by the stride, rounded down.
        stride_px: side of a cell.
        sigma_cells: standard deviation; the official maps have 0.5 at stride 8.
    """
    width, height = width_px // stride_px, height_px // stride_px
    maps = np.zeros((9, height, width), np.float32)
    reach = int(2.0 * sigma_cells)
    for channel, (u, v) in _cells(uv_px, stride_px):
        if not (reach <= u < width - reach and reach <= v < height - reach):
            continue
        rows = np.arange(int(v) - reach, int(v) + reach + 1)
        cols = np.arange(int(u) - reach, int(u) + reach + 1)
        squared = (rows[:, None] - v) ** 2 + (cols[None, :] - u) ** 2
        part = maps[channel, rows[0] : rows[-1] + 1, cols[0] : cols[-1] + 1]
        np.maximum(part, np.exp(-squared / (2.0 * sigma_cells**2)), out=part, casting="same_kind")
    return maps


def vector_fields(
    uv_px: Array, *, width_px: int, height_px: int, stride_px: int, radius_cells: int = FIELD_RADIUS_CELLS
) -> Maps:
    """(16, H, W) float32: unit vector to the centroid, in a disc around each of the 8 corners; else zero.

    Channels 2i and 2i + 1 hold x (right) and y (down) for corner i. A corner that coincides with its centroid
    has a zero vector.

    Args:
        uv_px: (N, 9, 2) points of N objects in DOPE's order; NaN for a point behind the camera.
        width_px, height_px: image size; H and W are these divided by the stride, rounded down.
        stride_px: side of a cell.
        radius_cells: radius of the disc around the corner's cell.
    """
    width, height = width_px // stride_px, height_px // stride_px
    fields = np.zeros((8, 2, height, width))
    for points in uv_px:
        for channel, (u, v) in _cells(points[None, :8], stride_px):
            to_centroid = points[8] - points[channel]
            length = np.linalg.norm(to_centroid)
            if not length > 0.0:
                continue
            row, col = math.floor(v), math.floor(u)
            rows = np.arange(max(row - radius_cells, 0), min(row + radius_cells + 1, height))
            cols = np.arange(max(col - radius_cells, 0), min(col + radius_cells + 1, width))
            disc = (rows[:, None] - row) ** 2 + (cols[None, :] - col) ** 2 <= radius_cells**2
            fields[channel][:, *np.ix_(rows, cols)] += (to_centroid / length)[:, None, None] * disc
    norms = np.linalg.norm(fields, axis=1, keepdims=True)
    return (
        np.divide(fields, norms, out=fields, where=norms > 0.0).reshape(16, height, width).astype(np.float32)
    )


def _cells(uv_px: Array, stride_px: int) -> list[tuple[int, tuple[float, float]]]:
    """(channel, (u, v) in cells) of each known point."""
    return [
        (channel, (float(u) / stride_px, float(v) / stride_px))
        for points in uv_px
        for channel, (u, v) in enumerate(points)
        if np.isfinite(u) and np.isfinite(v)
    ]
