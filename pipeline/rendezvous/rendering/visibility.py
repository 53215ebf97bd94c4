"""How much of a thing a picture shows, and where."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Box = tuple[float, float, float, float]


@dataclass(frozen=True, slots=True, kw_only=True)
class RobotView:
    """What a picture shows of the robot.

    Attributes:
        visibility: visible pixels / pixels of the whole silhouette; 0 where nothing is seen.
        box_px: x0, y0, x1, y1 of the outer edges of the visible pixels; None where nothing is seen.
        visible_px: number of visible pixels.
        silhouette_px: number of pixels it would cover with nothing in front, on a canvas large enough.
    """

    visibility: float
    box_px: Box | None
    visible_px: int
    silhouette_px: int


def robot_view(instance_ids: NDArray[np.int32], robot_ids: Sequence[int], *, silhouette_px: int) -> RobotView:
    """What (H, W) instance ids show of the instances that are the robot."""
    visible = np.isin(instance_ids, robot_ids)
    visible_px = int(np.count_nonzero(visible))
    # The two passes may round an edge's pixel to different sides.
    silhouette_px = max(silhouette_px, visible_px)
    return RobotView(
        visibility=visible_px / silhouette_px if visible_px else 0.0,
        box_px=_box_around(visible) if visible_px else None,
        visible_px=visible_px,
        silhouette_px=silhouette_px,
    )


def _box_around(mask: NDArray[np.bool_]) -> Box:
    """The pixels' outer edges: a pixel reaches half a pixel around its centre."""
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    x0, y0, x1, y1 = (float(i) for i in (columns[0], rows[0], columns[-1], rows[-1]))
    return x0 - 0.5, y0 - 0.5, x1 + 0.5, y1 + 0.5
