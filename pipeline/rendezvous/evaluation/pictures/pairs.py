"""The sheet of pairs: what robot 0 sees, each robot's map, and both maps laid over each other."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from rendezvous.evaluation.pictures.canvas import (
    BLUE,
    INK,
    MUTED,
    PAPER,
    RED,
    SHEET_MARGIN_PX,
    SHEET_WIDTH_PX,
    UNSEEN,
    Canvas,
    Colour,
    fitted_view,
    shortened,
    titled,
)
from rendezvous.evaluation.pictures.map_panels import BOTH, SEEN, WEDGE, PairMaps, bounds_m, map_panel
from rendezvous.evaluation.pictures.poses import draw_label_legend, labelled_image, visibility_words
from rendezvous.geometry.camera import Image
from rendezvous.geometry.se2 import SE2

_GAP_PX = 20
_MARGIN_M = 0.3
_PANEL_SHARES = (0.3, 0.3, 0.4)
_PANEL_HEIGHT_PX = 380
_VIEW_WIDTH_PX, _VIEW_CAPTION_PX = 340, 30
_HEADER_PX, _LEGEND_PX, _ROW_HEADER_PX = 148, 32, 62

Span = tuple[int, int]
"""Left and right pixel of a panel."""


def contact_sheet(rows: Sequence[Mapping[str, Any]], *, title: str, subtitle: str = "") -> Image:
    """One line of panels per pair: map 0, map 1, and both aligned by `T_m0_m1_local`.

    If any row has an image, the lines begin with what robot 0 sees.

    Args:
        rows: rows of `PAIRS.rows` or `EXPLORE.rows`.
        title, subtitle: first line of the sheet.

    Returns:
        (H, SHEET_WIDTH_PX, 3) uint8 RGB.

    Raises:
        PipelineError: an image or a map cannot be decoded.
    """
    pictured = any(row.get("image") is not None for row in rows)
    strips = [_strip(PairMaps.of(row), pictured=pictured) for row in rows]
    foot = Canvas(SHEET_WIDTH_PX, SHEET_MARGIN_PX).image
    return np.concatenate([_header(title, subtitle, pictured=pictured), *strips, foot])


def _header(title: str, subtitle: str, *, pictured: bool) -> Image:
    canvas = titled(SHEET_WIDTH_PX, _HEADER_PX + (_LEGEND_PX if pictured else 0), title, subtitle)
    _legend(canvas, SHEET_MARGIN_PX, 88)
    if pictured:
        draw_label_legend(canvas, SHEET_MARGIN_PX, 88 + _LEGEND_PX)
    names = ["Map of robot 0, which sees", "Map of robot 1, which is seen", "Both, aligned where they meet"]
    lefts_px = [left_px for left_px, _ in _map_spans(pictured=pictured)]
    if pictured:
        names = ["What robot 0 sees", "Map of robot 0", "Map of robot 1", names[-1]]
        lefts_px = [SHEET_MARGIN_PX, *lefts_px]
    for name, left_px in zip(names, lefts_px, strict=True):
        canvas.text(name, left_px, canvas.image.shape[0] - 14, size_px=21, bold=True)
    return canvas.image


def _legend(canvas: Canvas, u_px: float, v_px: float) -> None:
    """Draws swatches and what they stand for, on one line."""
    entries: list[tuple[Sequence[Colour], str]] = [
        ((SEEN[0], RED), "robot 0: known area, walls"),
        ((SEEN[1], BLUE), "robot 1: known area, walls"),
        ((SEEN[2], BOTH), "both"),
        ((WEDGE,), "camera's view"),
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


def _map_spans(*, pictured: bool) -> list[Span]:
    """The spans of the three panels of maps, beside a picture or not."""
    first_px = SHEET_MARGIN_PX + (_VIEW_WIDTH_PX + _GAP_PX if pictured else 0)
    inner_px = SHEET_WIDTH_PX - SHEET_MARGIN_PX - first_px - 2 * _GAP_PX
    widths_px = [round(share * inner_px) for share in _PANEL_SHARES]
    lefts_px = [first_px + sum(widths_px[:i]) + i * _GAP_PX for i in range(3)]
    return [(left, left + width) for left, width in zip(lefts_px, widths_px, strict=True)]


def _strip(pair: PairMaps, *, pictured: bool) -> Image:
    """A line of figures above the panels of one pair."""
    view = _view(pair.row) if pictured else Canvas(0, 0).image
    maps = _maps(pair, _map_spans(pictured=pictured), least_height_px=view.shape[0])
    canvas = Canvas(SHEET_WIDTH_PX, _ROW_HEADER_PX + maps.shape[0])
    canvas.paste(maps, 0, _ROW_HEADER_PX)
    canvas.paste(view, SHEET_MARGIN_PX, _ROW_HEADER_PX)
    _figures_line(canvas, pair.row)
    return canvas.image


def _view(row: Mapping[str, Any]) -> Image:
    """What robot 0 sees, with the visible share of robot 1 below."""
    if row.get("image") is None:
        canvas = Canvas(_VIEW_WIDTH_PX, _VIEW_CAPTION_PX)
        canvas.text("no image", 0, 22, size_px=19, colour=MUTED)
        return canvas.image
    image = labelled_image(row, width_px=_VIEW_WIDTH_PX)
    canvas = Canvas(_VIEW_WIDTH_PX, image.shape[0] + _VIEW_CAPTION_PX)
    canvas.paste(image, 0, 0)
    canvas.text(visibility_words(row), 0, image.shape[0] + 24, size_px=19)
    return canvas.image


def _maps(pair: PairMaps, spans: Sequence[Span], *, least_height_px: int) -> Image:
    """The three panels of maps side by side, all at one scale."""
    T_w_m0: SE2 = pair.row["T_w_m0"]
    placed = [[(0, SE2.identity())], [(1, SE2.identity())], [(i, T_w_m0 @ pair.T_m0_m(i)) for i in (0, 1)]]
    boxes = [bounds_m([(pair.grids[i], T) for i, T in layers], _MARGIN_M) for layers in placed]
    px_per_m = min(
        min((right - left) / (upper - lower)[0], _PANEL_HEIGHT_PX / (upper - lower)[1])
        for (left, right), (lower, upper) in zip(spans, boxes, strict=True)
    )
    height_px = math.ceil(px_per_m * max((upper - lower)[1] for lower, upper in boxes))
    height_px = max(height_px, least_height_px)
    canvas = Canvas(SHEET_WIDTH_PX, height_px)
    for panel, ((left, right), (lower, upper), layers) in enumerate(zip(spans, boxes, placed, strict=True)):
        centre_px = ((right - left) / 2.0, height_px / 2.0)
        view = fitted_view(lower, upper, px_per_m=px_per_m, centre_uv_px=centre_px)
        size_px = (right - left, height_px)
        canvas.image[:, left:right] = map_panel(pair, layers, view, size_px, T_w_m0 if panel == 2 else None)
    return canvas.image


def _figures_line(canvas: Canvas, row: Mapping[str, Any]) -> None:
    right_px = SHEET_WIDTH_PX - SHEET_MARGIN_PX
    rule_px = np.array([[SHEET_MARGIN_PX, 14.0], [right_px, 14.0]])
    canvas.polyline(rule_px, colour=UNSEEN, width_px=2)
    end_px = canvas.text(f"overlap {row['overlap']:.2f}", SHEET_MARGIN_PX, 46, size_px=22, bold=True)
    agreement = row["wall_agreement_local"]
    slam = " and ".join(
        f"{100 * row[f'slam_position_error_{i}_m']:.1f} cm "
        f"{math.degrees(row[f'slam_heading_error_{i}_rad']):.1f}°"
        for i in (0, 1)
    )
    odometry = " and ".join(f"{100 * row[f'odometry_position_error_{i}_m']:.0f} cm" for i in (0, 1))
    facts = [
        f"walls agree {100 * agreement:.1f} %" if agreement is not None else "no wall in common",
        f"SLAM off by {slam}",
        f"odometry by {odometry}",
        f"seen at {row['range_m']:.1f} m after {row['t_s']:.0f} s",
    ]
    canvas.text(" · ".join(facts), end_px + 18, 46, size_px=19)
    canvas.text(shortened(row["plan_id"], 12), right_px, 46, size_px=19, colour=MUTED, right=True)
