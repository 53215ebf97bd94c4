"""Panels of a pair: one robot's map with its path, or both maps laid over each other."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np

from rendezvous.evaluation.pictures.canvas import BLUE, INK, PAPER, RED, UNSEEN, Canvas, Colour, View
from rendezvous.geometry.camera import Image
from rendezvous.geometry.occupancy_grid import FREE, OCCUPIED, UNKNOWN, Mask, OccupancyGrid, grid_from_png
from rendezvous.geometry.se2 import SE2, Array

SEEN: tuple[Colour, Colour, Colour] = ((251, 228, 226), (222, 233, 250), (240, 234, 244))
"""What robot 0, robot 1 and both know to be free."""
BOTH: Colour = (74, 28, 92)
"""Walls that both have."""
WEDGE: Colour = (245, 190, 66)
"""The camera's field of view."""

_COLOURS = (RED, BLUE)
_ROBOT_RADIUS_M = 0.105

Layers = Sequence[tuple[int, SE2]]
"""The robots whose maps are drawn, each with `T_d_m`, the pose of its map in the panel's frame d."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PairMaps:
    """A row of `pairs` and its decoded maps."""

    row: Mapping[str, Any]
    grids: tuple[OccupancyGrid, OccupancyGrid]

    @staticmethod
    def of(row: Mapping[str, Any]) -> PairMaps:
        """Decodes the maps of a row of `PAIRS.rows`.

        Raises:
            MapError: a map is not a greyscale PNG.
        """
        grid_0, grid_1 = (
            grid_from_png(row[f"map_{i}"], resolution_m=row["resolution_m"], T_m_g=row[f"origin_{i}"])
            for i in (0, 1)
        )
        return PairMaps(row=row, grids=(grid_0, grid_1))

    def T_m0_m(self, robot: int, *, true: bool = False) -> SE2:
        """The pose of a robot's map in m0 as they agree at the rendezvous, or as the robots started."""
        return self.row["T_m0_m1" if true else "T_m0_m1_local"] if robot else SE2.identity()


def bounds_m(placed: Iterable[tuple[OccupancyGrid, SE2]], margin_m: float) -> tuple[Array, Array]:
    """Lower and upper corner (2,) [m] around all known cells of maps, each with its pose in the panel."""
    points_m = np.concatenate([T_d_m @ grid.cell_centres(grid.known()) for grid, T_d_m in placed])
    return points_m.min(axis=0) - margin_m, points_m.max(axis=0) + margin_m


def map_panel(
    pair: PairMaps,
    layers: Layers,
    view: View,
    size_px: tuple[int, int],
    T_w_m0: SE2 | None,
) -> Image:
    """Cells, paths and robots of one map in its own frame, or of both maps in w if given `T_w_m0`."""
    canvas = Canvas(*size_px, UNSEEN)
    maps = [sampled(pair.grids[i], T, view, size_px) for i, T in layers]
    greys = [(maps[0] == FREE, PAPER), (maps[0] == OCCUPIED, INK)]
    canvas.image[:] = blended(maps) if T_w_m0 else _halved(_painted(greys))
    if T_w_m0:
        _draw_sighting(canvas, pair, view, T_w_m0)
    for robot, T in layers:
        true = T_w_m0 @ pair.T_m0_m(robot, true=True) if T_w_m0 else T
        _draw_path(canvas, pair, robot, view, T_d_m=T, T_d_m_true=true)
    if T_w_m0:
        canvas.scale_bar(14, size_px[1] - 16, px_per_m=view.px_per_m, longest_px=160)
    return canvas.image


def sampled(grid: OccupancyGrid, T_d_m: SE2, view: View, size_px: tuple[int, int]) -> Image:
    """(2H, 2W) the map's values at twice the panel's resolution, in the panel's frame d."""
    # From pixels to cells is an affine map: sums of a row and a column instead of products at each pixel.
    T_g_d = (T_d_m @ grid.T_m_g).inverse()
    first, along_u, along_v = (
        T_g_d @ view.p_m(np.array([[0.0, 0.0], [0.5, 0.0], [0.0, 0.5]])) / grid.resolution_m
    )
    u, v = (np.arange(2 * px) for px in size_px)
    col, row = (
        np.clip(np.floor(at + (du - at) * u + ((dv - at) * v)[:, None]), -1, cells).astype(np.intp)
        for at, du, dv, cells in zip(first, along_u, along_v, grid.cells.shape[::-1], strict=True)
    )
    bordered = np.pad(grid.cells, 1, constant_values=UNKNOWN)
    return bordered[row + 1, col + 1]


def blended(cells: Sequence[Image]) -> Image:
    """Two maps of `sampled` over each other, as `in_colours` paints them, at half the size."""
    return _halved(in_colours([c != UNKNOWN for c in cells], [c == OCCUPIED for c in cells]))


def in_colours(known: Sequence[Mask] | Mask, walls: Sequence[Mask] | Mask) -> Image:
    """What two maps know, and their walls: red and blue where one has something, violet where both do."""
    return _painted(
        [
            (known[0], SEEN[0]),
            (known[1], SEEN[1]),
            (known[0] & known[1], SEEN[2]),
            (walls[0], RED),
            (walls[1], BLUE),
            (walls[0] & walls[1], BOTH),
        ]
    )


def _painted(layers: Sequence[tuple[Mask, Colour]]) -> Image:
    """Colours where masks (H, W) hold, later ones on top."""
    image = np.full((*layers[0][0].shape, 3), UNSEEN, np.uint8)
    for mask, colour in layers:
        image[mask] = colour
    return image


def _halved(image: Image) -> Image:
    half = (image.shape[1] // 2, image.shape[0] // 2)
    return np.asarray(cv2.resize(image, half, interpolation=cv2.INTER_AREA), dtype=np.uint8)


def _draw_path(
    canvas: Canvas, pair: PairMaps, robot: int, view: View, *, T_d_m: SE2, T_d_m_true: SE2
) -> None:
    """Draws a robot, its start, and its path: by SLAM as a thick line, the true one as a thin line."""
    colour = _COLOURS[robot]
    estimated_m, true_m = (pair.row[f"trajectory_{robot}{suffix}"][:, 1:3] for suffix in ("", "_true"))
    canvas.polyline(view.uv_px(T_d_m @ estimated_m), colour=colour, width_px=3)
    canvas.polyline(view.uv_px(T_d_m_true @ true_m), colour=INK)
    canvas.disc(view.uv_px(T_d_m @ estimated_m[:1])[0], radius_px=5, colour=PAPER, outline=colour)
    draw_robot(canvas, view, T_d_m @ pair.row[f"T_m{robot}_r{robot}"], colour)


def draw_robot(canvas: Canvas, view: View, T_d_r: SE2, colour: Colour) -> None:
    """Draws a disc with a nose, as large as the robot, but never too small to be seen."""
    radius_px = max(_ROBOT_RADIUS_M * view.px_per_m, 7.0)
    nose_m = np.array([[0.0, 0.0], [2.0 * radius_px / view.px_per_m, 0.0]])
    nose_px = view.uv_px(T_d_r @ nose_m)
    canvas.polyline(nose_px, colour=PAPER, width_px=7)
    canvas.disc(nose_px[0], radius_px=radius_px, colour=colour)
    canvas.polyline(nose_px, colour=colour, width_px=4)


def _draw_sighting(canvas: Canvas, pair: PairMaps, view: View, T_w_m0: SE2) -> None:
    """Draws the camera's field of view, as far as the robot that it sees."""
    row = pair.row
    left_rad = math.atan2(row["K"][0, 2] + 0.5, row["K"][0, 0])
    right_rad = -math.atan2(row["image_width_px"] - 0.5 - row["K"][0, 2], row["K"][0, 0])
    angles_rad = np.linspace(right_rad, left_rad, 24)
    arc_m = row["range_m"] * np.stack([np.cos(angles_rad), np.sin(angles_rad)], axis=1)
    wedge_px = view.uv_px(T_w_m0 @ row["T_m0_r0"] @ np.concatenate([np.zeros((1, 2)), arc_m]))
    canvas.polygon(wedge_px, colour=WEDGE, opacity=0.3)
    canvas.polyline(wedge_px, colour=WEDGE, width_px=2, closed=True)
