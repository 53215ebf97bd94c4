"""Pictures of rendezvous: each robot's map, and both laid over each other where the robots met."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np

from pipeline.evaluation.canvas import (
    BLUE,
    INK,
    MUTED,
    PAPER,
    RED,
    SHEET_WIDTH_PX,
    UNSEEN,
    Canvas,
    Colour,
    Image,
    View,
    fitted_view,
    shortened,
)
from pipeline.geometry.occupancy_grid import FREE, OCCUPIED, UNKNOWN, OccupancyGrid, grid_from_png
from pipeline.geometry.se2 import SE2, Array

_MARGIN_PX, _GAP_PX = 28, 20
_PANEL_SHARES = (0.3, 0.3, 0.4)
_PANEL_HEIGHT_PX, _PANEL_MARGIN_M = 380, 0.3
_HEADER_PX, _ROW_HEADER_PX = 148, 62
_ROBOT_RADIUS_M = 0.105

_COLOURS = (RED, BLUE)
_SEEN: tuple[Colour, Colour, Colour] = ((251, 228, 226), (222, 233, 250), (240, 234, 244))
_BOTH: Colour = (74, 28, 92)
_WEDGE: Colour = (245, 190, 66)


@dataclass(frozen=True, slots=True, kw_only=True)
class Rendezvous:
    """One row of the pairs table, as a picture needs it."""

    row: Mapping[str, Any]
    grids: tuple[OccupancyGrid, OccupancyGrid]

    @staticmethod
    def of(row: Mapping[str, Any]) -> Rendezvous:
        """Decodes the maps of a row of `PAIRS.rows`.

        Raises:
            MapError: a map is no greyscale PNG.
        """
        grid_0, grid_1 = (
            grid_from_png(row[f"map_{i}"], resolution_m=row["resolution_m"], T_m_g=row[f"origin_{i}"])
            for i in (0, 1)
        )
        return Rendezvous(row=row, grids=(grid_0, grid_1))

    def T_m0_m(self, robot: int) -> SE2:
        """Where the maps agree at the meeting: the pose of a robot's map in m0."""
        local: SE2 = self.row["T_m0_m1_local"]
        return local if robot else SE2.identity()

    def T_m0_m_true(self, robot: int) -> SE2:
        """The pose of a robot's true start in m0."""
        start: SE2 = self.row["T_m0_m1"]
        return start if robot else SE2.identity()


def contact_sheet(rows: Sequence[Mapping[str, Any]], *, title: str, subtitle: str = "") -> Image:
    """One line of three panels per rendezvous: map 0, map 1, and both aligned by `T_m0_m1_local`.

    Args:
        rows: rows as `PAIRS.rows` gives them.
        title, subtitle: first line of the sheet.

    Returns:
        (H, SHEET_WIDTH_PX, 3) uint8 RGB.
    """
    strips = [_strip(Rendezvous.of(row)) for row in rows]
    foot = Canvas(SHEET_WIDTH_PX, _MARGIN_PX).image
    return np.concatenate([_header(title, subtitle), *strips, foot])


def _header(title: str, subtitle: str) -> Image:
    canvas = Canvas(SHEET_WIDTH_PX, _HEADER_PX)
    end_px = canvas.text(title, _MARGIN_PX, 48, size_px=32, bold=True)
    canvas.text(subtitle, end_px + 18, 48, size_px=20, colour=MUTED)
    _legend(canvas, _MARGIN_PX, 88)
    names = ("Map of robot 0, which sees", "Map of robot 1, which is seen", "Both, aligned where they meet")
    for name, (left_px, _) in zip(names, _panel_spans(), strict=True):
        canvas.text(name, left_px, 134, size_px=21, bold=True)
    return canvas.image


def _legend(canvas: Canvas, u_px: float, v_px: float) -> None:
    """Swatches and what they stand for, on one line."""
    entries: list[tuple[Sequence[Colour], str]] = [
        ((_SEEN[0], RED), "robot 0: known area, walls"),
        ((_SEEN[1], BLUE), "robot 1: known area, walls"),
        ((_SEEN[2], _BOTH), "both"),
        ((_WEDGE,), "camera's view"),
    ]
    for colours, name in entries:
        for colour in colours:
            box = np.add([[0, -15], [18, -15], [18, 3], [0, 3]], (u_px, v_px))
            canvas.polygon(box, colour=colour)
            canvas.polyline(box, colour=MUTED, closed=True)
            u_px += 22
        u_px = canvas.text(name, u_px + 4, v_px, size_px=19) + 30
    for width_px, colour, name in ((4, RED, "path by SLAM"), (1, INK, "true path")):
        canvas.polyline(np.array([[u_px, v_px - 6], [u_px + 40, v_px - 6]]), colour=colour, width_px=width_px)
        u_px = canvas.text(name, u_px + 48, v_px, size_px=19) + 30
    canvas.disc(np.array([u_px + 6, v_px - 6]), radius_px=5, colour=PAPER, outline=RED)
    canvas.text("start", u_px + 22, v_px, size_px=19)


def _panel_spans() -> list[tuple[int, int]]:
    """Left and right pixel of each panel."""
    inner_px = SHEET_WIDTH_PX - 2 * _MARGIN_PX - 2 * _GAP_PX
    widths_px = [round(share * inner_px) for share in _PANEL_SHARES]
    lefts_px = [_MARGIN_PX + sum(widths_px[:i]) + i * _GAP_PX for i in range(3)]
    return [(left, left + width) for left, width in zip(lefts_px, widths_px, strict=True)]


def _strip(pair: Rendezvous) -> Image:
    """One rendezvous: a line of figures over its three panels, all at one scale."""
    T_w_m0: SE2 = pair.row["T_w_m0"]
    placed = [[(0, SE2.identity())], [(1, SE2.identity())], [(i, T_w_m0 @ pair.T_m0_m(i)) for i in (0, 1)]]
    boxes = [_bounds(pair, layers) for layers in placed]
    spans = _panel_spans()
    px_per_m = min(
        min((right - left) / (upper - lower)[0], _PANEL_HEIGHT_PX / (upper - lower)[1])
        for (left, right), (lower, upper) in zip(spans, boxes, strict=True)
    )
    height_px = math.ceil(px_per_m * max((upper - lower)[1] for lower, upper in boxes))
    canvas = Canvas(SHEET_WIDTH_PX, _ROW_HEADER_PX + height_px)
    _figures_line(canvas, pair.row)
    for panel, ((left, right), (lower, upper), layers) in enumerate(zip(spans, boxes, placed, strict=True)):
        centre_px = ((right - left) / 2.0, height_px / 2.0)
        view = fitted_view(lower, upper, px_per_m=px_per_m, centre_uv_px=centre_px)
        image = _panel(pair, layers, view, (right - left, height_px), T_w_m0 if panel == 2 else None)
        canvas.image[_ROW_HEADER_PX:, left:right] = image
    return canvas.image


def _figures_line(canvas: Canvas, row: Mapping[str, Any]) -> None:
    canvas.polyline(
        np.array([[_MARGIN_PX, 14.0], [SHEET_WIDTH_PX - _MARGIN_PX, 14.0]]), colour=UNSEEN, width_px=2
    )
    end_px = canvas.text(f"overlap {row['overlap']:.2f}", _MARGIN_PX, 46, size_px=22, bold=True)
    agreement = row["wall_agreement_local"]
    errors = " and ".join(
        f"{100 * row[f'slam_position_error_{i}_m']:.1f} cm "
        f"{math.degrees(row[f'slam_heading_error_{i}_rad']):.1f}°"
        for i in (0, 1)
    )
    odometry = " and ".join(f"{100 * row[f'odometry_position_error_{i}_m']:.0f} cm" for i in (0, 1))
    facts = [
        f"walls agree {100 * agreement:.1f} %" if agreement is not None else "no wall in common",
        f"SLAM off by {errors}",
        f"odometry by {odometry}",
        f"seen at {row['range_m']:.1f} m after {row['t_s']:.0f} s",
    ]
    canvas.text(" · ".join(facts), end_px + 18, 46, size_px=19)
    canvas.text(
        shortened(row["plan_id"], 12), SHEET_WIDTH_PX - _MARGIN_PX, 46, size_px=19, colour=MUTED, right=True
    )


def _bounds(pair: Rendezvous, layers: Sequence[tuple[int, SE2]]) -> tuple[Array, Array]:
    """Lower and upper corner [m] around what the maps of a panel know, with a margin."""
    points_m = np.concatenate([T @ pair.grids[i].cell_centres(pair.grids[i].known()) for i, T in layers])
    return points_m.min(axis=0) - _PANEL_MARGIN_M, points_m.max(axis=0) + _PANEL_MARGIN_M


def _panel(
    pair: Rendezvous,
    layers: Sequence[tuple[int, SE2]],
    view: View,
    size_px: tuple[int, int],
    T_w_m0: SE2 | None,
) -> Image:
    """One panel: cells, paths and robots of one map in its own frame, or of both in w (`T_w_m0`)."""
    canvas = Canvas(*size_px, UNSEEN)
    sampled = [_sample(pair.grids[i], T, view, size_px) for i, T in layers]
    canvas.image[:] = _blend(sampled) if T_w_m0 else _greys(sampled[0])
    if T_w_m0:
        _draw_sighting(canvas, pair, view, T_w_m0)
    for robot, T in layers:
        true = T_w_m0 @ pair.T_m0_m_true(robot) if T_w_m0 else T
        _draw_path(canvas, pair, robot, view, T_d_m=T, T_d_m_true=true)
    if T_w_m0:
        canvas.scale_bar(14, size_px[1] - 16, px_per_m=view.px_per_m, longest_px=160)
    return canvas.image


def _sample(grid: OccupancyGrid, T_d_m: SE2, view: View, size_px: tuple[int, int]) -> Image:
    """(2H, 2W) the map's values at twice the panel's pixels, in the panel's frame d."""
    width_px, height_px = size_px
    u, v = np.meshgrid(np.arange(2 * width_px) / 2.0, np.arange(2 * height_px) / 2.0)
    return grid.sample(T_d_m.inverse() @ view.p_m(np.stack([u, v], axis=-1)))


def _greys(cells: Image) -> Image:
    return _halved(_painted([(cells == FREE, PAPER), (cells == OCCUPIED, INK)], cells.shape))


def _blend(cells: Sequence[Image]) -> Image:
    """Red and blue where one map has something, violet where both have."""
    known = [c != UNKNOWN for c in cells]
    walls = [c == OCCUPIED for c in cells]
    return _halved(
        _painted(
            [
                (known[0], _SEEN[0]),
                (known[1], _SEEN[1]),
                (known[0] & known[1], _SEEN[2]),
                (walls[0], RED),
                (walls[1], BLUE),
                (walls[0] & walls[1], _BOTH),
            ],
            cells[0].shape,
        )
    )


def _painted(layers: Sequence[tuple[Any, Colour]], shape: tuple[int, ...]) -> Image:
    image = np.full((*shape, 3), UNSEEN, np.uint8)
    for mask, colour in layers:
        image[mask] = colour
    return image


def _halved(image: Image) -> Image:
    half = (image.shape[1] // 2, image.shape[0] // 2)
    return np.asarray(cv2.resize(image, half, interpolation=cv2.INTER_AREA), dtype=np.uint8)


def _draw_path(
    canvas: Canvas, pair: Rendezvous, robot: int, view: View, *, T_d_m: SE2, T_d_m_true: SE2
) -> None:
    """The robot's path by SLAM, thick, and the true one, thin; its start, and the robot where it met."""
    colour = _COLOURS[robot]
    estimated_m, true_m = (pair.row[f"trajectory_{robot}{suffix}"][:, 1:3] for suffix in ("", "_true"))
    canvas.polyline(view.uv_px(T_d_m @ estimated_m), colour=colour, width_px=3)
    canvas.polyline(view.uv_px(T_d_m_true @ true_m), colour=INK)
    canvas.disc(view.uv_px(T_d_m @ estimated_m[:1])[0], radius_px=5, colour=PAPER, outline=colour)
    _draw_robot(canvas, view, T_d_m @ pair.row[f"T_m{robot}_r{robot}"], colour)


def _draw_robot(canvas: Canvas, view: View, T_d_r: SE2, colour: Colour) -> None:
    radius_px = max(_ROBOT_RADIUS_M * view.px_per_m, 7.0)
    nose_m = np.array([[0.0, 0.0], [2.0 * radius_px / view.px_per_m, 0.0]])
    nose_px = view.uv_px(T_d_r @ nose_m)
    canvas.polyline(nose_px, colour=PAPER, width_px=7)
    canvas.disc(nose_px[0], radius_px=radius_px, colour=colour)
    canvas.polyline(nose_px, colour=colour, width_px=4)


def _draw_sighting(canvas: Canvas, pair: Rendezvous, view: View, T_w_m0: SE2) -> None:
    """The camera's field of view, as far as the robot it sees."""
    row = pair.row
    left_rad = math.atan2(row["K"][0, 2] + 0.5, row["K"][0, 0])
    right_rad = -math.atan2(row["image_width_px"] - 0.5 - row["K"][0, 2], row["K"][0, 0])
    angles_rad = np.linspace(right_rad, left_rad, 24)
    arc_m = row["range_m"] * np.stack([np.cos(angles_rad), np.sin(angles_rad)], axis=1)
    wedge_px = view.uv_px(T_w_m0 @ row["T_m0_r0"] @ np.concatenate([np.zeros((1, 2)), arc_m]))
    canvas.polygon(wedge_px, colour=_WEDGE, opacity=0.3)
    canvas.polyline(wedge_px, colour=_WEDGE, width_px=2, closed=True)
